"""Convex parts of what stands on the support: nothing reaches into it, and what touches it is flat.

A guessed underside is round where the true one was flat, and millimetres too low: in physics the object
would be thrown up and rock. What was seen at rest has a contact patch. Knows meshes and a height; nothing of
formats.
"""

from __future__ import annotations

import numpy as np
import trimesh

from reconstruction.export.collision import ConvexParts
from reconstruction.export.hulls import convex_hull
from reconstruction.export.refine import bulges
from reconstruction.solid import Solid

REACH = 0.004
"""An object whose lowest point is this near the support stands on it [m]."""
PATCH = 0.0025
"""All of the surface that is this near the support touches it [m]: no more than the parts are wrong
anyway."""
BULGE = 0.0027
"""A part that would reach further out of the mesh with its foot gets none [m]."""


def with_footing(parts: ConvexParts, solid: trimesh.Trimesh, support: float) -> ConvexParts:
    """The parts of a solid that stands on the plane z = `support` [m], each ended at it and flat where near.

    All in a frame whose z axis is the support's normal. Objects that stand elsewhere stay as they are.
    """
    if abs(float(solid.bounds[0, 2]) - support) > REACH:
        return parts
    corners = [np.asarray(part.vertices) for part in parts.parts]
    footed = {
        number: hull
        for number, points in enumerate(corners)
        if points[:, 2].min() < support + PATCH
        and (hull := convex_hull(_on_the_plane(points, support))) is not None
    }
    depths = bulges(list(footed.values()), Solid(solid)) if footed else []
    kept = {number for number, (depth, _) in zip(footed, depths) if depth <= BULGE}
    found = tuple(
        hull
        for number, points in enumerate(corners)
        if (hull := footed[number] if number in kept else convex_hull(_raised(points, support))) is not None
    )
    return ConvexParts(found, solid) if found else parts


def _raised(points: np.ndarray, support: float) -> np.ndarray:
    return np.column_stack([points[:, :2], np.maximum(points[:, 2], support)])


def _on_the_plane(points: np.ndarray, support: float) -> np.ndarray:
    """The points, none below the support, and below those that are near it their places on it as well: parts
    that lie there as a whole stay as thick as they are."""
    near = points[points[:, 2] < support + PATCH]
    return np.concatenate(
        [_raised(points, support), np.column_stack([near[:, :2], np.full(len(near), support)])]
    )
