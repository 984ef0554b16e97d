"""Which true objects are vessels, and how much of their outside was seen.

Knows true meshes and measured points in one frame; knows nothing of predictions.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import trimesh
from scipy import ndimage
from scipy.spatial import cKDTree

from reconstruction.solid import Solid

HOLDS = 0.3
"""A vessel holds at least this share of its hull's volume, standing on one of its six sides."""
CELLS = 48
"""Cells of a height map along its longer side."""
SAMPLES = 60_000
"""Surface points that a height map is made of."""
ON_HULL = 0.006
"""The outside is what is no farther than this from the hull [m] ..."""
DOWN = -0.5
"""... and does not face down more than this: on its foot no view sees it."""
SEEN_WITHIN = 0.005
"""Seen is what lies this near to a measured point [m]."""


@lru_cache(maxsize=64)
def is_vessel(solid: Solid) -> bool:
    """Whether an object is a cup, bowl, plate, pan or basket, in whatever pose: something stays in it."""
    mesh = solid.mesh
    points = trimesh.sample.sample_surface(mesh, SAMPLES, seed=0)[0]
    points = np.concatenate([points, np.asarray(mesh.vertices)])
    points = points - points.mean(0)
    points = points @ np.linalg.eigh(points.T @ points)[1]  # a vessel's axis is one of these
    most = max(_held(sign * np.roll(points, axis, 1)) for axis in range(3) for sign in (1, -1))
    return bool(most > HOLDS * mesh.convex_hull.volume)


def _held(points: np.ndarray) -> float:
    """How much [m^3] stays on a surface (N, 3) when it is poured over along the last axis."""
    from skimage.morphology import reconstruction

    points = points - points.min(0)
    size = points[:, :2].max() / CELLS
    cell = (points[:, :2] / size).astype(int) + 3
    height = np.full(cell.max(0) + 4, -1.0)
    np.maximum.at(height, tuple(cell.T), points[:, 2])
    # What has no floor holds nothing; single cells lack a sample.
    through = ndimage.binary_opening(height < 0, np.ones((3, 3)))
    height = np.where(height < 0, ndimage.maximum_filter(height, 3), height)
    height[through] = 0
    level = np.where(through, 0, height.max())
    return float((reconstruction(level, height, method="erosion") - height).sum() * size**2)


def outside_seen(true: trimesh.Trimesh, seen: np.ndarray) -> float:
    """Share of a true object's outside, its foot left out, that is near to measured points (N, 3); its z axis
    is up."""
    points, faces = trimesh.sample.sample_surface(true, 8000, seed=0)[:2]
    hull = true.convex_hull
    off = np.abs(points @ hull.face_normals.T - (hull.face_normals * hull.triangles[:, 0]).sum(1)).min(1)
    outside = points[(off < ON_HULL) & (true.face_normals[faces][:, 2] > DOWN)]
    if not len(outside):
        return 0.0
    return float((cKDTree(seen).query(outside)[0] < SEEN_WITHIN).mean())
