"""Convex hulls as engines take them: closed, wound outwards, not flat. Knows points only."""

from __future__ import annotations

import numpy as np
import trimesh

LEAST_VOLUME = 1e-11
"""Splinters smaller than this [m^3], a fifth of a millimetre in size, are left out: engines refuse flat
parts."""


def convex_hull(points: np.ndarray) -> trimesh.Trimesh | None:
    """The closed convex hull of a part; None when it is flat, which no engine accepts."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        found = ConvexHull(points)
    except (QhullError, ValueError):
        return None
    number = np.zeros(len(points), int)
    number[found.vertices] = np.arange(len(found.vertices))
    corners, faces = points[found.vertices], number[found.simplices]
    # Qhull leaves the winding open; outwards is where its plane's normal points.
    a, b, c = (corners[faces[:, i]] for i in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), found.equations[:, :3]) < 0
    faces[inwards] = faces[inwards, ::-1]
    hull = trimesh.Trimesh(corners, faces, process=False)
    return hull if hull.volume > LEAST_VOLUME else None
