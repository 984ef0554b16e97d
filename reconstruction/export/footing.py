"""Convex parts of what stands on the support: nothing reaches into it, and what touches it is flat.

A guessed underside is round where the true one was flat, and millimetres too low: in physics the object
would be thrown up and rock. What was seen at rest has a contact patch. Knows meshes and a height; nothing of
formats.
"""

from __future__ import annotations

import numpy as np
import trimesh

from reconstruction.export.collision import ConvexParts, convex_hull
from reconstruction.export.parts_error import parts_error

REACH = 0.004
"""An object whose lowest point is this near the support stands on it [m]."""
PATCH = 0.003
"""All of the surface that is this near the support touches it [m]: no more than the parts are wrong
anyway."""


def with_footing(parts: ConvexParts, solid: trimesh.Trimesh, support: float) -> ConvexParts:
    """The parts of a solid that stands on the plane z = `support` [m], each ended at it and flat where near.

    All in a frame whose z axis is the support's normal. Objects that stand elsewhere stay as they are.
    """
    if abs(float(solid.bounds[0, 2]) - support) > REACH:
        return parts
    hulls = [convex_hull(_on_the_plane(np.asarray(part.vertices), support)) for part in parts.parts]
    found = tuple(hull for hull in hulls if hull is not None)
    return ConvexParts(found, *parts_error(solid, found)) if found else parts


def _on_the_plane(points: np.ndarray, support: float) -> np.ndarray:
    height = points[:, 2]
    return np.column_stack([points[:, :2], np.where(height < support + PATCH, support, height)])
