"""Convex hulls as engines take them: closed, wound outwards, not flat. Knows points only."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh

from reconstruction.export.cutting import Surface, hull_surface


def convex_hull(points: np.ndarray) -> trimesh.Trimesh | None:
    """The closed convex hull of points (N, 3) [m]; None when it is flat, which no engine accepts."""
    import manifold3d

    found = hull_surface(manifold3d.Manifold.hull_points(points))
    return None if found is None else as_mesh(found)


def as_mesh(surface: Surface) -> trimesh.Trimesh:
    """Vertices and faces as a mesh, as they are."""
    return trimesh.Trimesh(*surface, process=False)


def surfaces(meshes: Sequence[trimesh.Trimesh]) -> list[Surface]:
    """Vertices and faces of each mesh."""
    return [(np.asarray(mesh.vertices), np.asarray(mesh.faces)) for mesh in meshes]
