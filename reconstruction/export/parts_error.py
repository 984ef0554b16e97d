"""How far convex parts and the mesh they stand for disagree. Knows meshes only."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh

from reconstruction.solid import Solid

SAMPLES = 2000
"""Points drawn on either surface, beside all vertices."""
MOST_PAIRS = 10_000_000
"""Points times faces that are compared one by one; above it, rays are cast."""


def parts_error(mesh: trimesh.Trimesh, parts: Sequence[trimesh.Trimesh]) -> tuple[float, float]:
    """Largest distance [m] of the mesh's surface from the parts' union, and of the parts' surface from the
    mesh.

    Points inside of the other count as 0: the first is what the parts lack, the second what they have too
    much.
    """
    together = trimesh.util.concatenate(list(parts))
    assert isinstance(together, trimesh.Trimesh)
    solid, union = Solid(mesh), Solid(together)
    mine, theirs = _points(mesh), _points(union.mesh)
    lacking = mine[~_inside_any(mine, parts)]
    surplus = theirs[~solid.inside(theirs)]
    return (
        float(union.distance(lacking).max()) if len(lacking) else 0.0,
        float(solid.distance(surplus).max()) if len(surplus) else 0.0,
    )


def _points(mesh: trimesh.Trimesh) -> np.ndarray:
    """Vertices and evenly drawn surface points (N, 3) [m]."""
    drawn, _ = trimesh.sample.sample_surface(mesh, SAMPLES, seed=0)
    return np.concatenate([mesh.vertices, drawn]).astype(np.float32)


def _inside_any(points: np.ndarray, parts: Sequence[trimesh.Trimesh]) -> np.ndarray:
    """Which points (N, 3) lie in one of the convex parts: behind all planes of its faces."""
    inside = np.zeros(len(points), bool)
    for part in parts:
        low, high = part.bounds
        near = np.flatnonzero(~inside & (points >= low).all(1) & (points <= high).all(1))
        if len(near) * len(part.faces) > MOST_PAIRS:
            inside[near] = Solid(part).inside(points[near])
            continue
        normals = part.face_normals
        height = np.einsum("ij,ij->i", normals, part.triangles[:, 0])
        inside[near] = (points[near] @ normals.T <= height).all(1)
    return inside
