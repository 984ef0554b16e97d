"""Bodies cut into convex parts: the boolean work, on plain arrays.

Knows manifold3d's solids and nothing else of the project: a process that cuts starts in a third of a second.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

LEAST_VOLUME = 1e-11
"""Splinters smaller than this [m^3], a fifth of a millimetre in size, are left out: engines refuse flat
parts."""
LEAST_GAP = 1e-9
"""A part that holds less than this beside its body [m^3], a cube of a millimetre, is as good as convex."""
Surface = tuple[np.ndarray, np.ndarray]
"""Vertices (V, 3) [m] and faces (F, 3) of a closed mesh."""


def solid_of(vertices: np.ndarray, faces: np.ndarray) -> Any:
    """A closed mesh [m] as a `manifold3d.Manifold`; None when it is not manifold."""
    import manifold3d

    solid = manifold3d.Manifold(
        manifold3d.Mesh(np.asarray(vertices, np.float32), np.asarray(faces, np.uint32))
    )
    return None if solid.status() != manifold3d.Error.NoError or solid.is_empty() else solid


def hull_surface(hull: Any) -> Surface | None:
    """A convex `manifold3d.Manifold` as arrays; None when it is flat or empty."""
    if hull.is_empty() or hull.volume() <= LEAST_VOLUME:
        return None
    found = hull.to_mesh64()
    return np.array(found.vert_properties[:, :3]), np.array(found.tri_verts, np.int64)


@dataclass(frozen=True)
class _Part:
    """A convex part, and what of the body it is the hull of once that has been worked out."""

    hull: Surface
    within: Any = None


class Cutter:
    """A body that is cut into convex parts, ever more of them.

    body: a `manifold3d.Manifold`, or None for a mesh that is not manifold, whose parts stay whole. The time
    is that of its triangles.
    """

    def __init__(self, body: Any, points: Sequence[np.ndarray]) -> None:
        """points: (N, 3) [m] each, whose hulls are the first parts."""
        import manifold3d

        self._body = body
        hulls = (hull_surface(manifold3d.Manifold.hull_points(cloud)) for cloud in points)
        self._parts = [_Part(hull) for hull in hulls if hull is not None]

    @classmethod
    def of_pieces(cls, pieces: Sequence[Any]) -> Cutter:
        """Bodies, each a `manifold3d.Manifold`, whose hulls are the first parts."""
        found = cls(None, [])
        parts = ((hull_surface(piece.hull()), piece) for piece in pieces)
        found._parts = [_Part(hull, piece) for hull, piece in parts if hull is not None]
        return found

    @property
    def hulls(self) -> list[Surface]:
        """The parts there are now."""
        return [part.hull for part in self._parts]

    def halve(self, wanted: Sequence[int], places: np.ndarray) -> list[list[Surface]]:
        """Cut the parts with the numbers `wanted` in two through places (N, 3) [m] in them.

        Returns the two halves of each, or nothing for one that cannot be cut; the halves are the parts there
        are then, in this order.
        """
        halves = [self._halves(self._parts[part], place) for part, place in zip(wanted, places)]
        self._parts = [half for pair in halves for half in pair]
        return [[half.hull for half in pair] for pair in halves]

    def _halves(self, part: _Part, place: np.ndarray) -> list[_Part]:
        """The body within a part on either side of the plane, of three through `place` (3,), that leaves the
        least hulls; [] where cutting gains nothing."""
        import manifold3d

        if self._body is None and part.within is None:
            return []
        corners = part.hull[0]
        # A half lies within its whole: only the first cut looks at all of the body.
        hull = manifold3d.Manifold.hull_points(corners)
        within = hull ^ self._body if part.within is None else part.within
        if hull.volume() - within.volume() < LEAST_GAP:
            return []
        surface = within.to_mesh64()
        points, faces = np.asarray(surface.vert_properties[:, :3]), np.asarray(surface.tri_verts)
        edges = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        edges = edges[edges[:, 0] < edges[:, 1]]  # of a closed surface, each once
        _, _, axes = np.linalg.svd(corners - corners.mean(0), full_matrices=False)
        planes = [(axis, float(axis @ place)) for axis in axes]
        for axis, height in sorted(planes, key=lambda plane: _size(points, edges, *plane)):
            sides = within.split_by_plane(axis, height)
            halves = [_Part(half, side) for side in sides if (half := hull_surface(side.hull())) is not None]
            if len(halves) == 2:
                return halves
        return []


def _size(points: np.ndarray, edges: np.ndarray, axis: np.ndarray, level: float) -> float:
    """Volume [m^3] of the hulls of a body's corners (N, 3) and edges (M, 2) on either side of axis x = level.

    Nothing is cut: that would take four times as long.
    """
    import manifold3d

    height = points @ axis - level
    above = height > 0
    begin, end = edges[above[edges[:, 0]] != above[edges[:, 1]]].T
    share = (height[begin] / (height[begin] - height[end]))[:, None]
    there = points[begin] + share * (points[end] - points[begin])
    sides = (np.concatenate([points[side], there]) for side in (above, ~above))
    return sum(manifold3d.Manifold.hull_points(side).volume() for side in sides)
