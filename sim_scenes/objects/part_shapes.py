"""Convex parts of simple bodies, for physics: each part is an array of points (N, 3) [m] whose hull it is."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
import trimesh
from numpy.typing import ArrayLike

Polygon = Sequence[tuple[float, float]]
"""Corners (radius, z) [m] of a convex cross-section."""

SECTORS = 20
"""Pieces a ring is cut into."""


def turned(polygons: Iterable[Polygon]) -> list[np.ndarray]:
    """Convex polygons turned about z: one part each if it reaches the axis, else a ring of parts."""
    parts = []
    for polygon in polygons:
        section = np.array(polygon, float)
        if section[:, 0].min() <= 1e-9:
            parts.append(_swept(section, np.linspace(0, 2 * np.pi, 48, endpoint=False)))
            continue
        for start, end in pairwise(np.linspace(0, 2 * np.pi, SECTORS + 1)):
            parts.append(_swept(section, np.linspace(start, end, 3)))
    return parts


def stacked(outline: Polygon) -> list[np.ndarray]:
    """The solid within an outline of rising (radius, z), cut where the outline is not convex."""
    nodes = [(max(radius, 1e-6), z) for radius, z in outline]
    polygons, start = [], 0
    for index in range(2, len(nodes) + 1):
        if index == len(nodes) or not _bulges(nodes[start : index + 1]):
            piece = nodes[start:index]
            polygons.append([(0.0, piece[0][1]), *piece, (0.0, piece[-1][1])])
            start = index - 1
    return turned(polygons)


def bars(path: np.ndarray, radii: np.ndarray) -> list[np.ndarray]:
    """Round bars along a polyline (N, 3) with a radius at each node (N,): one part a segment."""
    ball = 1.05 * trimesh.creation.icosphere(subdivisions=1).vertices  # its faces lie inside the sphere
    return [
        np.concatenate([a + ball * radius_a, b + ball * radius_b])
        for (a, radius_a), (b, radius_b) in pairwise(zip(path, radii))
    ]


def block(center: ArrayLike, half: ArrayLike, rounding: float = 0.0) -> np.ndarray:
    """An axis-aligned box; rounded edges become chamfers, so that its faces stay where they are."""
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
    faces = [np.asarray(half) - rounding * (np.arange(3) != axis) for axis in range(3)]
    return np.concatenate([np.asarray(center) + signs * face for face in faces])


def shell(outer: Polygon, inner: Polygon) -> list[np.ndarray]:
    """A turned wall between two lines of equally many (radius, z) nodes: a ring of parts per step."""
    steps = zip(pairwise(outer), pairwise(inner))
    return turned([[*pair_outer, *pair_inner] for pair_outer, pair_inner in steps])


def _swept(section: np.ndarray, angles: np.ndarray) -> np.ndarray:
    radius, z = np.repeat(section[:, 0], len(angles)), np.repeat(section[:, 1], len(angles))
    turn = np.tile(angles, len(section))
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)


def _bulges(nodes: Polygon) -> bool:
    """Whether an outline turns towards the axis all along."""
    steps = np.diff(np.array(nodes), axis=0)
    cross = steps[:-1, 0] * steps[1:, 1] - steps[:-1, 1] * steps[1:, 0]
    return bool((cross >= -1e-9).all())
