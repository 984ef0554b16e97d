"""Convex parts of what stands on the support: nothing reaches into it, and what touches it is flat.

A guessed underside is round where the true one was flat, and millimetres too low: in physics the object
would be thrown up and rock. What was seen at rest has a contact patch. Knows meshes and a height; nothing of
formats.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh

from reconstruction.export.apart import below
from reconstruction.export.collision import ConvexParts
from reconstruction.export.hulls import Hull, convex_hull, surfaces
from reconstruction.export.refine import bulges
from reconstruction.solid import Solid

REACH = 0.008
"""An object is cut off at a support that it reaches into by no more than this [m]: undersides are never
seen."""
PATCH = 0.0025
"""All of the surface that is this near the lowest point, or the support, touches the support [m], up to
BULGE above it: no more than the parts are wrong anyway."""
BULGE = 0.0029
"""A part that would reach further out of the mesh with its foot gets none [m]. What hovers higher over the
support gets blocks below it, which are no part of it (unseen_support)."""


def with_footing(parts: ConvexParts, solid: trimesh.Trimesh, support: float) -> ConvexParts:
    """The parts of a solid that stands on the plane z = `support` [m], each ended at it and flat where near.

    All in a frame whose z axis is the support's normal. Objects that stand elsewhere stay as they are.
    """
    gap = float(solid.bounds[0, 2]) - support
    if not -REACH <= gap <= BULGE:
        return parts
    near = min(max(gap, 0.0) + PATCH, BULGE)
    wanted = [part for part in parts.parts if part.bounds[0, 2] < support + near]
    whole = [_footed(part.vertices, support, near) for part in wanted]
    feet = [_foot(part, support, near) for part in wanted]
    body = Solid(solid)
    fits = [_fits(of_one, body, BULGE) for of_one in (whole, feet)]
    found: list[Hull | None] = []
    found += [part for part in parts.parts if part.bounds[0, 2] >= support + near]
    for number, part in enumerate(wanted):
        if fits[0][number]:
            found.append(whole[number])
            continue
        found.append(convex_hull(_raised(part.vertices, support)))
        if fits[1][number]:
            found.append(feet[number])
    kept = tuple(hull for hull in found if hull is not None)
    return ConvexParts(kept, solid, parts.note) if kept else parts


def _fits(parts: Sequence[Hull | None], body: Solid, limit: float) -> list[bool]:
    """Which of the parts there are and reach out of the body by no more than `limit` [m]."""
    there = [part for part in parts if part is not None]
    depths = iter(bulges(surfaces(there), body, limit) if there else [])
    return [part is not None and next(depths)[0] <= limit for part in parts]


def _raised(points: np.ndarray, support: float) -> np.ndarray:
    return np.column_stack([points[:, :2], np.maximum(points[:, 2], support)])


def _footed(points: np.ndarray, support: float, near: float) -> Hull | None:
    """A part's hull with the places on the support below its corners (N, 3) that are `near` it.

    Parts that lie there as a whole stay as thick as they are.
    """
    low = points[points[:, 2] < support + near]
    on_it = np.column_stack([low[:, :2], np.full(len(low), support)])
    return convex_hull(np.concatenate([_raised(points, support), on_it]))


def _foot(part: Hull, support: float, near: float) -> Hull | None:
    """What of a part is `near` the support and all below it down to the support: a foot of its own."""
    low = below(part, np.array([0.0, 0.0, 1.0]), support + near)
    return None if low is None else _footed(low.vertices, support, np.inf)
