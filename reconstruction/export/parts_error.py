"""How far convex parts and the mesh they stand for disagree. Knows meshes only."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh

from reconstruction.export.hulls import Hull, together
from reconstruction.solid import Solid

SAMPLES = 2000
"""Points drawn on either surface, beside all vertices."""
MOST_PAIRS = 10_000_000
"""Points times faces that are compared one by one; above it, rays are cast."""
AT_A_TIME = 1000
"""Points asked whether they are inside, the farthest from all surfaces first."""


def parts_error(mesh: trimesh.Trimesh, parts: Sequence[Hull]) -> tuple[float, float]:
    """Largest distance [m] of the mesh's surface from the parts' union, and of the parts' surface from the
    mesh.

    Points inside of the other count as 0: the first is what the parts lack, the second what they have too
    much.
    """
    solid, union = Solid(mesh), Union(parts)
    theirs = surface_points(union.mesh)
    surplus = theirs[~solid.inside(theirs)]
    return (
        union.most_lacking(surface_points(mesh)),
        float(solid.distance(surplus).max()) if len(surplus) else 0.0,
    )


class Union:
    """Convex parts, made ready for questions of how far points are from them."""

    def __init__(self, parts: Sequence[Hull]) -> None:
        self.mesh = together(parts)
        self._hulls = list(parts)
        self._boxes = np.array([hull.bounds for hull in parts])
        self._surface = Solid(self.mesh)

    def lacking(self, points: np.ndarray, least: float = 0.0) -> np.ndarray:
        """How far points (N, 3) [m] are from all parts: (N,) [m], 0 within.

        Those no further than `least` from the surface of a part count as 0 as well: asking whether they are
        inside is what takes time.
        """
        found = np.zeros(len(points))
        if len(points) == 0:
            return found
        distances = self._surface.distance(points)
        far = np.flatnonzero(distances > least)
        outside = far[~self._inside(points[far])]
        found[outside] = distances[outside]
        return found

    def most_lacking(self, points: np.ndarray) -> float:
        """The largest distance [m] of points (N, 3) from all parts, 0 within."""
        distances = self._surface.distance(points)
        order = np.argsort(-distances, kind="stable")
        # Few points of a mesh are deep within its parts: most need not be asked.
        for first in range(0, len(order), AT_A_TIME):
            some = order[first : first + AT_A_TIME]
            outside = ~self._inside(points[some])
            if outside.any():
                return float(distances[some[outside]].max())
        return 0.0

    def _inside(self, points: np.ndarray) -> np.ndarray:
        """Which points (N, 3) lie in one of the parts."""
        found = np.zeros(len(points), bool)
        if len(points) == 0:
            return found
        # Hundreds of parts, each small: only those among the points, and the points within their range of x.
        order = np.argsort(points[:, 0], kind="stable")
        ordered = points[order]
        met = (self._boxes[:, 0] <= points.max(0)).all(1) & (self._boxes[:, 1] >= points.min(0)).all(1)
        ranges = np.searchsorted(ordered[:, 0], self._boxes[:, :, 0])
        inside = np.zeros(len(points), bool)
        for number in np.flatnonzero(met & (ranges[:, 0] < ranges[:, 1])):
            first, last = ranges[number]
            span, (low, high) = ordered[first:last], self._boxes[number]
            near = first + np.flatnonzero(
                ~inside[first:last] & (span[:, 1:] >= low[1:]).all(1) & (span[:, 1:] <= high[1:]).all(1)
            )
            if len(near):
                inside[near] = _holds(self._hulls[number], ordered[near])
        found[order] = inside
        return found


def _holds(part: Hull, points: np.ndarray) -> np.ndarray:
    """Which points (N, 3) lie behind all planes of a part's faces."""
    if len(points) * len(part.faces) > MOST_PAIRS:
        return Solid(part.mesh).inside(points)
    return (points @ part.face_normals.T <= part.heights).all(1)


def surface_points(mesh: trimesh.Trimesh) -> np.ndarray:
    """Vertices and evenly drawn surface points (N, 3) [m]."""
    drawn, _ = trimesh.sample.sample_surface(mesh, SAMPLES, seed=0)
    return np.concatenate([mesh.vertices, drawn]).astype(np.float32)
