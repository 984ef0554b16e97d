"""What must hold up an object that stands on nothing known: blocks in the unseen space below it.

Things were seen at rest. One that ends above the support rests on something: on a neighbour, with places that
are hidden, or on what nobody has seen. Physics would let it fall. Knows convex parts in a frame with z up and
which places were seen to be empty; knows nothing of formats.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from reconstruction.export.apart import Parts, boxes, overlap
from reconstruction.export.balance import STEADY, gathered, room_within
from reconstruction.export.hulls import Hull, together
from reconstruction.solid import Solid

WHY = (
    "seen at rest, and nothing known holds it there: fixed blocks in the unseen space below it do, "
    "which a planner may leave out"
)
WIDTH, THICKNESS = 0.006, 0.01
"""Of a block at most [m]."""
THIN = 0.003
"""Thickness of a block where there is no room for more [m]."""
BELOW = 0.0003
"""Blocks end this far below the object's parts [m]: fixed as the support is, they may be as near."""
CLEAR = 0.0012
"""From other objects' parts [m]: pybullet lifts these by up to a millimetre, and nothing must press on them
then."""
LEAST_THICKNESS = 0.0005
"""Of a block [m]."""
MOST = 12
"""Blocks below an object at most."""
ACROSS = 5
"""Places along either side of a block where the object's underside is looked for."""
STEP = 0.002
"""Undersides no further apart in height than this are as good as each other [m]."""


CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


@dataclass(frozen=True)
class Block:
    """An upright box: its centre (3,) and whole size (3,) [m] in the table frame."""

    centre: np.ndarray
    size: np.ndarray

    @property
    def top(self) -> float:
        """Height of its upper face [m]."""
        return float(self.centre[2] + self.size[2] / 2)

    def shortened(self, thickness: float) -> Block:
        """Its upper end, no thicker than `thickness` [m]."""
        height = min(thickness, self.size[2])
        return Block(np.array([*self.centre[:2], self.top - height / 2]), np.array([*self.size[:2], height]))

    @property
    def hull(self) -> Hull:
        """The block as a convex part."""
        return Hull.of(trimesh.creation.box(self.size).apply_translation(self.centre))

    @property
    def corners(self) -> np.ndarray:
        """(8, 3) [m]"""
        return self.centre + self.size / 2 * CORNERS


def unseen_support(
    own: Parts,
    others: Sequence[Parts],
    centre: np.ndarray,
    is_free: Callable[[np.ndarray], np.ndarray],
) -> tuple[Block, ...]:
    """Blocks that end BELOW an object's underside, so that it rests on them and on what else it touches.

    own: the object's convex parts; others: those of each other object; all in the table frame, where the
    support is z = 0. centre: (3,) the object's centre of mass. is_free: which of points (N, 3) were seen to
    be empty: no block is there. () where all below it was.
    """
    below = _below(own)
    if not below:
        return ()
    nodes = np.concatenate([[block.centre, *block.corners] for block in below])
    free = is_free(nodes).reshape(len(below), -1).any(1)
    unseen = [below[number] for number in np.flatnonzero(~free)]
    around = [part for parts in others for part in parts]
    limits = boxes(around)
    found = [fitting for block in unseen if (fitting := _fitting(block, around, limits)) is not None]
    if not found:
        return ()
    places = np.array([block.centre for block in found])
    tops = np.array([block.top for block in found])
    chosen = _lowest_that_hold(centre, places, tops)
    spread = [found[chosen[number]] for number in _spread(places[chosen, :2], centre[:2])]
    return tuple(lower for block in spread if (lower := _clear_of(block, own)) is not None)


def _lowest_that_hold(centre: np.ndarray, places: np.ndarray, tops: np.ndarray) -> np.ndarray:
    """Numbers of the lowest of places (N, 3) with heights `tops` (N,) that hold a centre of mass (3,) well;
    where none do, of the lowest that leave it most room."""
    # What is seen from above hangs over at its sides as well.
    found, best = np.arange(len(tops)), -np.inf
    for level in np.arange(tops.min(), tops.max() + STEP, STEP):
        low = np.flatnonzero(tops <= level + STEP)
        room = room_within(centre, gathered(places[low]))
        if room > best:
            found, best = low, room
        if best >= STEADY:
            break
    return found


def _below(parts: Parts) -> list[Block]:
    """A block below each cell of a level lattice that the parts cover at least half of."""
    whole = together(parts)
    low, high = whole.bounds
    cells = np.ceil((high[:2] - low[:2]) / WIDTH).astype(int)
    start = (low[:2] + high[:2] - cells * WIDTH) / 2
    within = np.linspace(0, WIDTH, ACROSS)
    x = start[0] + (WIDTH * np.arange(cells[0])[:, None] + within).ravel()
    y = start[1] + (WIDTH * np.arange(cells[1])[:, None] + within).ravel()
    places = np.stack([*np.meshgrid(x, y, indexing="ij"), np.full((len(x), len(y)), low[2] - WIDTH)], -1)
    up = np.broadcast_to([0.0, 0.0, 1.0], places.shape)
    rise = Solid(whole).cast(places.reshape(-1, 3), up.reshape(-1, 3)).reshape(len(x), len(y))
    rise = rise.reshape(cells[0], ACROSS, cells[1], ACROSS).transpose(0, 2, 1, 3).reshape(*cells, -1)
    covered = np.isfinite(rise).mean(-1) >= 0.5
    top = low[2] - WIDTH + rise.min(-1) - BELOW
    found = []
    for i, j in np.argwhere(covered & (top > LEAST_THICKNESS)):
        bottom = max(0.0, top[i, j] - THICKNESS)
        middle = [*(start + WIDTH * (np.array([i, j]) + 0.5)), (top[i, j] + bottom) / 2]
        found.append(Block(np.array(middle), np.array([WIDTH, WIDTH, top[i, j] - bottom])))
    return found


def _fitting(block: Block, around: Sequence[Hull], limits: np.ndarray) -> Block | None:
    """The block, or its upper end, where no part of another object, in boxes (N, 2, 3), is nearer than
    CLEAR."""
    for thickness in (THICKNESS, THIN, LEAST_THICKNESS):
        fitting = block.shortened(thickness)
        low, high = fitting.centre - fitting.size / 2, fitting.centre + fitting.size / 2
        near = np.flatnonzero(((limits[:, 0] < high + CLEAR) & (limits[:, 1] > low - CLEAR)).all(1))
        if len(near) == 0:
            return fitting
        hull = fitting.hull
        if all(overlap(hull, around[int(number)], CLEAR) is None for number in near):
            return fitting
    return None


def _clear_of(block: Block, own: Parts) -> Block | None:
    """The block without its upper end where a tip of the object's own parts, between the places looked at,
    reaches into it."""
    limits = boxes(own)
    while block.size[2] > BELOW:
        low, high = block.centre - block.size / 2, block.centre + block.size / 2
        near = np.flatnonzero(((limits[:, 0] < high) & (limits[:, 1] > low)).all(1))
        hull = block.hull
        if all(overlap(hull, own[int(number)], 0.0) is None for number in near):
            return block
        size = block.size - [0.0, 0.0, BELOW]
        block = Block(block.centre - [0.0, 0.0, BELOW / 2], size)
    return None


def _spread(places: np.ndarray, start: np.ndarray) -> list[int]:
    """Numbers of at most MOST of places (N, 2): the nearest to `start` (2,), then ever the farthest from all
    chosen ones."""
    chosen = [int(np.linalg.norm(places - start, axis=1).argmin())]
    away = np.linalg.norm(places - places[chosen[0]], axis=1)
    while len(chosen) < MOST and away.max() > 0:
        chosen.append(int(away.argmax()))
        away = np.minimum(away, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return chosen
