"""What keeps objects where they were seen at rest: unseen supports below them, and where their mass is.

Knows convex parts and even centres of mass of all objects in a frame with z up, whose support is z = 0;
nothing of formats.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from reconstruction.export.apart import Parts
from reconstruction.export.balance import FOOT, balanced, extent_of, resting_points, well_within
from reconstruction.export.unseen_support import Block, unseen_support

Supports = Mapping[int, tuple[Block, ...]]


def unseen_supports(
    objects: Mapping[int, Parts],
    centres: Mapping[int, np.ndarray],
    is_free: Callable[[np.ndarray], np.ndarray],
) -> dict[int, tuple[Block, ...]]:
    """Label -> blocks below each object that stands on nothing known, or is not in balance there.

    is_free: which of points (N, 3) [m] were seen to be empty.
    """
    found = {}
    for label, centre in centres.items():
        resting = resting_points(label, objects, 0.0, centre[2])
        stands = bool((resting[:, 2] < FOOT).any())
        if stands and well_within(balanced(centre, resting, extent_of(objects[label])), resting):
            continue
        others = [parts for other, parts in objects.items() if other != label]
        if blocks := unseen_support(objects[label], others, centre, is_free):
            found[label] = blocks
    return found


def held_centres(
    objects: Mapping[int, Parts], centres: Mapping[int, np.ndarray], supports: Supports
) -> dict[int, np.ndarray]:
    """Label -> centre of mass (3,) [m], moved to where the object does not fall from where it was seen."""
    found = {}
    for label, centre in centres.items():
        held = [block.corners for block in supports.get(label, ())]
        resting = np.concatenate([resting_points(label, objects, 0.0, centre[2]), *held])
        found[label] = balanced(centre, resting, extent_of(objects[label]))
    return found
