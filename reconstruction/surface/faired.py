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
    steps = np.array([TOWARDS, BACK] * rounds, np.float32)
    return _moved(start, *_rings(faces, free, len(start)), free.astype(np.float32), steps, np.float32(most))


@compiled
def _rings(faces: np.ndarray, free: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Neighbours of the vertices that move, one vertex's after the other's, and where each one's begin
    (count + 1,).

    Around a vertex of a closed surface each neighbour comes next to it in one triangle.
    """
    starts = np.zeros(count + 1, np.int32)
    for f in range(len(faces)):
        for corner in range(3):
            starts[faces[f, corner] + 1] += free[faces[f, corner]] > 0
    starts = np.cumsum(starts).astype(np.int32)
    at, neighbours = starts[:-1].copy(), np.empty(starts[-1], np.int32)
    for f in range(len(faces)):
        for corner in range(3):
            v = faces[f, corner]
            if free[v] > 0:
                neighbours[at[v]] = faces[f, corner - 2]
                at[v] += 1
    return neighbours, starts


@compiled
def _moved(
    start: np.ndarray,
    neighbours: np.ndarray,
    starts: np.ndarray,
    free: np.ndarray,
    steps: np.ndarray,
    most: float,
) -> np.ndarray:
    """Vertices (V, 3) after all steps, each of which sees where the one before left them."""
    now, new = start.copy(), start.copy()
    for step in steps:
        for v in range(len(start)):
            first, last = starts[v], starts[v + 1]
            if first == last:
                continue
            x = y = z = np.float32(0)
            for n in range(first, last):
                u = neighbours[n]
                x, y, z = x + now[u, 0], y + now[u, 1], z + now[u, 2]
            share, each = step * free[v], np.float32(1) / np.float32(last - first)
            x = now[v, 0] + share * (x * each - now[v, 0]) - start[v, 0]
            y = now[v, 1] + share * (y * each - now[v, 1]) - start[v, 1]
            z = now[v, 2] + share * (z * each - now[v, 2]) - start[v, 2]
            away = x * x + y * y + z * z
            back = most / np.sqrt(away) if away > most * most else np.float32(1)
            new[v, 0], new[v, 1], new[v, 2] = (
                start[v, 0] + back * x,
                start[v, 1] + back * y,
                start[v, 2] + back * z,
            )
        now, new = new, now
    return now
