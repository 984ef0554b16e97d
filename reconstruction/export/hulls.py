"""Convex hulls as engines take them: closed, wound outwards, not flat. Knows points only."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh

LEAST_VOLUME = 1e-11
"""Splinters smaller than this [m^3], a fifth of a millimetre in size, are left out: engines refuse flat
parts."""


def convex_hull(points: np.ndarray) -> trimesh.Trimesh | None:
    """The closed convex hull of points (N, 3) [m]; None when it is flat, which no engine accepts."""
    import manifold3d

    return as_mesh(manifold3d.Manifold.hull_points(points))


def as_mesh(hull: Any) -> trimesh.Trimesh | None:
    """A convex `manifold3d.Manifold` as a mesh; None when it is flat or empty."""
    if hull.is_empty() or hull.volume() <= LEAST_VOLUME:
        return None
    found = hull.to_mesh64()
    return trimesh.Trimesh(np.asarray(found.vert_properties[:, :3]), found.tri_verts, process=False)
