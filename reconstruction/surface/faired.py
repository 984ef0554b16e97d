"""A closed surface without what lattice and pixels leave on it: teeth along outlines, steps on hidden sides.

Knows vertices, faces and how freely each vertex moves; knows nothing of images or maps. Source: Taubin, "A
Signal Processing Approach to Fair Surface Design", SIGGRAPH 1995: steps towards the neighbours' mean, each
followed by a longer one back, take away what is as short as an edge or two and keep the volume.
"""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled

TOWARDS, BACK = 0.6, -0.63
"""Shares of the way to the neighbours' mean that a vertex goes in turn."""


def faired(vertices: np.ndarray, faces: np.ndarray, free: np.ndarray, rounds: int, most: float) -> np.ndarray:
    """Vertices (V, 3) [m] of a closed surface with triangles (F, 3), moved by `most` [m] at the most.

    free: (V,) how freely each of them moves, 0: not at all, to 1; rounds: of two steps each.
    """
    start = np.ascontiguousarray(vertices, np.float32)
    moving = faces[(free > 0)[faces].any(1)]
    fans = np.bincount(faces.reshape(-1), minlength=len(vertices)).astype(np.float32)
    steps = np.array([TOWARDS, BACK] * rounds, np.float32)
    return _moved(start, moving, free.astype(np.float32), 2 * fans, steps, np.float32(most))


@compiled
def _moved(
    start: np.ndarray, faces: np.ndarray, free: np.ndarray, counts: np.ndarray, steps: np.ndarray, most: float
) -> np.ndarray:
    """Vertices (V, 3) after all steps. counts: (V,) how often faces name a vertex's neighbours, each twice;
    faces: all that hold a vertex which moves."""
    now, sums = start.copy(), np.empty_like(start)
    for step in steps:
        sums[:] = 0
        for f in range(len(faces)):
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            for axis in range(3):
                p, q, r = now[a, axis], now[b, axis], now[c, axis]
                sums[a, axis] += q + r
                sums[b, axis] += r + p
                sums[c, axis] += p + q
        for v in range(len(now)):
            if free[v] <= 0:
                continue
            share, away = step * free[v], np.float32(0)
            for axis in range(3):
                now[v, axis] += share * (sums[v, axis] / counts[v] - now[v, axis])
                away += (now[v, axis] - start[v, axis]) ** 2
            if away > most * most:
                back = most / np.sqrt(away)
                for axis in range(3):
                    now[v, axis] = start[v, axis] + back * (now[v, axis] - start[v, axis])
    return now
