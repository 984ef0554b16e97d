"""What keeps objects where they were seen at rest: unseen supports below them, and where their mass is.

Knows convex parts and even centres of mass of all objects in a frame with z up, whose support is z = 0;
nothing of formats.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from reconstruction.export.apart import Parts
from reconstruction.export.balance import balanced
from reconstruction.export.contacts import Contacts, contacts_of, corners_of
from reconstruction.export.unseen_support import Block, unseen_support


@dataclass(frozen=True)
class AtRest:
    """centres: label -> centre of mass (3,) [m], moved to where the object does not fall from where it was
    seen. supports: label -> blocks below each object that the ground alone does not hold."""

    centres: Mapping[int, np.ndarray]
    supports: Mapping[int, tuple[Block, ...]]


def at_rest(
    objects: Mapping[int, Parts],
    centres: Mapping[int, np.ndarray],
    is_free: Callable[[np.ndarray], np.ndarray],
) -> AtRest:
    """What keeps objects where they were seen.

    objects: label -> convex parts; centres: of mass, of an even density. is_free: which of points (N, 3) [m]
    were seen to be empty. What lies or leans on other objects gets blocks where there is room for them:
    the others may move as they settle, and none touches it before that.
    """
    moved, supports = {}, {}
    for label, centre in centres.items():
        corners = corners_of(objects[label])
        extent = float(np.linalg.norm(np.ptp(corners[:, :2], axis=0)))
        contacts = contacts_of(label, objects)
        ground = contacts.on_the_support()
        found = balanced(centre, ground, extent)
        if not found.steady:
            others = [parts for other, parts in objects.items() if other != label]
            if blocks := unseen_support(objects[label], others, centre, is_free):
                supports[label] = blocks
                tops = [block.corners[block.corners[:, 2] > block.centre[2]] for block in blocks]
                held = Contacts.upwards(np.concatenate(tops))
                ground, contacts = ground.joined(held), contacts.joined(held)
                found = balanced(centre, ground, extent)
        if not found.steady:
            found = balanced(centre, contacts, extent)
        moved[label] = found.centre
    return AtRest(moved, supports)
