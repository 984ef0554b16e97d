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
    solid, theirs = Solid(mesh), _points(_together(parts))
    surplus = theirs[~solid.inside(theirs)]
    return (
        float(lacking(_points(mesh), parts).max()),
        float(solid.distance(surplus).max()) if len(surplus) else 0.0,
    )


def lacking(points: np.ndarray, parts: Sequence[trimesh.Trimesh]) -> np.ndarray:
    """How far points (N, 3) [m] are from the union of convex parts: (N,) [m], 0 within."""
    outside = np.flatnonzero(~_inside_any(points, parts))
    found = np.zeros(len(points))
    if len(outside):
        found[outside] = Solid(_together(parts)).distance(points[outside])
    return found


def _together(parts: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    union = trimesh.util.concatenate(list(parts))
    assert isinstance(union, trimesh.Trimesh)
    return union


def _points(mesh: trimesh.Trimesh) -> np.ndarray:
    """Vertices and evenly drawn surface points (N, 3) [m]."""
    drawn, _ = trimesh.sample.sample_surface(mesh, SAMPLES, seed=0)
    return np.concatenate([mesh.vertices, drawn]).astype(np.float32)


def _inside_any(points: np.ndarray, parts: Sequence[trimesh.Trimesh]) -> np.ndarray:
    """Which points (N, 3) lie in one of the convex parts: behind all planes of its faces."""
    # Hundreds of parts, each small: only the points within its range of x are looked at.
    order = np.argsort(points[:, 0], kind="stable")
    ordered = points[order]
    inside = np.zeros(len(points), bool)
    for part in parts:
        low, high = part.bounds
        first, last = np.searchsorted(ordered[:, 0], [low[0], high[0]], side="left")
        span = ordered[first:last]
        near = first + np.flatnonzero(
            ~inside[first:last] & (span[:, 1:] >= low[1:]).all(1) & (span[:, 1:] <= high[1:]).all(1)
        )
        if len(near) * len(part.faces) > MOST_PAIRS:
            inside[near] = Solid(part).inside(ordered[near])
            continue
        normals = part.face_normals
        height = np.einsum("ij,ij->i", normals, part.triangles[:, 0])
        inside[near] = (ordered[near] @ normals.T <= height).all(1)
    found = np.empty(len(points), bool)
    found[order] = inside
    return found
