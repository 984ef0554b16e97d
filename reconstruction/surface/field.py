"""The map on one lattice over the scene: evaluated in blocks, only where an object can be.

Knows a fitted map whose class 0 is empty space; knows nothing of frames or meshes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mapping.compiled import compiled
from mapping.contramap import ContraMap
from mapping.lanes import LANES, every, exponential, larger, load, logarithm, minus, over, plus, store
from mapping.threads import map_in_threads
from reconstruction.surface.neighbours import beside

BLOCK = 24
"""Nodes a side of the blocks that are evaluated at a time, as far as objects can reach into them: a multiple
of COARSE, and of the numbers in a vector."""
COARSE = 4
"""The first pass looks at every 4th node."""
SKIP_LOG_ODDS = -4.0
"""An object's window ends where its log odds against empty space are below this at all coarse nodes around:
of 100,000 nodes inside of objects, thin ones among them, this lost none."""
OUTSIDE = -20.0
"""Log odds of what is surely outside."""
FLOOR_SLOPE = 2000.0
"""Log odds [1/m] may rise this steeply above the floor."""


Window = tuple[slice, slice, slice]
"""Index ranges of a part of a lattice."""


@dataclass(frozen=True)
class Field:
    """Log odds and uncertainty on the lattice origin + spacing * (i, j, k), in the map's frame.

    windows: the part of the lattice around each of K objects; log_odds: on each window, float32, of object k
    against the rest among the non-uncertain classes, OUTSIDE where the map rules the object out;
    uncertainty: (nx, ny, nz) float32 p(uncertain), 1 where no object can be.
    """

    origin: np.ndarray
    spacing: float
    windows: list[Window]
    log_odds: list[np.ndarray]
    uncertainty: np.ndarray

    def corner(self, window: Window) -> np.ndarray:
        """The first node (3,) of a window [m]."""
        return self.origin + self.spacing * np.array([w.start for w in window])


def window_of(
    origin: np.ndarray,
    spacing: float,
    shape: tuple[int, ...],
    low: np.ndarray,
    high: np.ndarray,
    pad: int = 0,
) -> Window:
    """The nodes of a lattice that cover the box low..high (3,) [m] and `pad` nodes around it."""
    first = np.clip(np.floor((low - origin) / spacing).astype(int) - pad, 0, shape)
    last = np.clip(np.ceil((high - origin) / spacing).astype(int) + 1 + pad, 0, shape)
    x, y, z = (slice(int(a), int(b)) for a, b in zip(first, last))
    return x, y, z


def overlap(a: Window, b: Window) -> Window:
    """What two windows have in common."""
    x, y, z = (slice(max(p.start, q.start), max(p.start, q.start, min(p.stop, q.stop))) for p, q in zip(a, b))
    return x, y, z


def within(part: Window, window: Window) -> Window:
    """The same nodes counted from a window's first one."""
    x, y, z = (slice(p.start - w.start, p.stop - w.start) for p, w in zip(part, window))
    return x, y, z


def extent(values: np.ndarray) -> Window | None:
    """The smallest window of a lattice that holds all nodes (nx, ny, nz) above 0; None where there are none.

    values: numbers, or bool.
    """
    ends = _ends(values.view(np.uint8) if values.dtype == bool else values)
    if ends[0] > ends[3]:
        return None
    x, y, z = (slice(first, last + 1) for first, last in zip(ends[:3], ends[3:]))
    return x, y, z


@compiled
def _ends(values: np.ndarray) -> tuple[int, ...]:
    nx, ny, nz = values.shape
    left, front, low, right, back, high = nx, ny, nz, -1, -1, -1
    for i in range(nx):
        for j in range(ny):
            row, some = values[i, j], np.uint8(0)
            for k in range(nz):  # without a way out: eight or more nodes at a time
                some |= np.uint8(row[k] > 0)
            if some:
                left, right, front, back = min(left, i), i, min(front, j), max(back, j)
                for k in range(low):
                    if row[k] > 0:
                        low = k
                        break
                for k in range(nz - 1, high, -1):
                    if row[k] > 0:
                        high = k
                        break
    return left, front, low, right, back, high


def evaluate_field(
    model: ContraMap,
    lows: np.ndarray,
    highs: np.ndarray,
    spacing: float,
    floors: Sequence[float] | None = None,
    confined: bool = True,
    classes: Sequence[int] | None = None,
) -> Field:
    """Evaluate a map on one lattice of `spacing` [m] over boxes lows..highs (K, 3) [m].

    An object's window is the part of its box that the map does not know to be without it. floors: heights
    (K,) [m] below which the objects are not. confined: objects have no part in the probabilities of blocks
    beyond their windows. classes: (K,) the objects' classes in the map, 1..K by default; all other classes
    but the empty and the uncertain one are rivals of every object.
    """
    last = model.class_count - 1
    own = list(classes or range(1, len(lows) + 1))
    rivals = [k for k in range(1, last) if k not in own]
    low, high = lows.min(0), highs.max(0)
    count = np.ceil((np.asarray(high) - low) / (spacing * BLOCK)).astype(int)
    # Multiples of the spacing: the same place is sampled alike whatever else is in the scene.
    origin = np.floor(np.asarray(low) / spacing) * spacing
    axes = [origin[i] + spacing * np.arange(count[i] * BLOCK) for i in range(3)]
    evaluator = model.lattice()
    coarse = evaluator([axis[::COARSE] for axis in axes])
    likely = _likely((coarse[own] - coarse[0]).cpu().numpy())
    shape = tuple(int(n) for n in count * BLOCK)
    boxes = [window_of(origin, spacing, shape, *box) for box in zip(lows, highs)]
    windows = [overlap(box, _fine(extent(nodes))) for box, nodes in zip(boxes, likely)]
    log_odds = [np.full([w.stop - w.start for w in window], OUTSIDE, np.float32) for window in windows]
    uncertainty = np.ones(shape, np.float32)
    lattice = evaluator.on(axes)
    # A steep ramp rather than a step: the surface is to end at the floor, not half a cell from it.
    ramps = [FLOOR_SLOPE * (axes[2] - floor).astype(np.float32) for floor in floors or ()]
    # Blocks that no object can be in are not looked at.
    of_blocks = likely.any(0).reshape([n for blocks in count for n in (blocks, BLOCK // COARSE)])
    blocks = np.argwhere(np.any(of_blocks, axis=(1, 3, 5)))
    parts = _parts(likely.view(np.uint8), np.array([[(s.start, s.stop) for s in w] for w in windows]), blocks)

    def fill(number: int) -> None:
        held = np.flatnonzero(parts[number, :, 0] < parts[number, :, 3])
        if not len(held):
            return
        ends = parts[number, held]
        first, beyond = ends[:, :3].min(0), ends[:, 3:].max(0)
        x, y, z = (slice(a, b) for a, b in zip(first.tolist(), beyond.tolist()))
        present = held.tolist() if confined else list(range(len(windows)))
        columns = [0, *(own[k] for k in present), *rivals, last]
        odds, unsure = _odds(lattice.lines((x, y, z), np.array(columns)), len(present))
        height = z.stop - z.start
        uncertainty[x, y, z] = unsure[..., :height]
        for k, ends_of_one in zip(held.tolist(), ends.tolist()):
            of_one = odds[present.index(k), ..., :height]
            if ramps:
                np.minimum(of_one, ramps[k][z], out=of_one)
            a, b, c, d, e, f = ends_of_one
            part = slice(a, d), slice(b, e), slice(c, f)
            log_odds[k][within(part, windows[k])] = of_one[within(part, (x, y, z))]

    map_in_threads(fill, range(len(blocks)))
    return Field(origin, spacing, windows, log_odds, uncertainty)


@compiled
def _parts(likely: np.ndarray, windows: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """Of each block (B, 3) the part where each object can be: (B, K, 6) its first nodes and those after its
    last ones along each axis, 0 where there is none. likely: (K, nx, ny, nz) coarse nodes; windows: (K, 3, 2)
    first node and the one after the last of each object's window."""
    side = BLOCK // COARSE
    found = np.zeros((len(blocks), len(likely), 6), np.int64)
    for b in range(len(blocks)):
        for k in range(len(likely)):
            x, y, z = side * blocks[b]
            ends, empty = _ends(likely[k, x : x + side, y : y + side, z : z + side]), False
            for axis in range(3):
                corner = side * blocks[b, axis]
                low = max(COARSE * (corner + ends[axis]), windows[k, axis, 0])
                high = min(COARSE * (corner + ends[axis + 3] + 1), windows[k, axis, 1])
                found[b, k, axis], found[b, k, axis + 3] = low, high
                empty = empty or ends[axis] > ends[axis + 3] or low >= high
            if empty:
                found[b, k] = 0
    return found


@compiled
def _odds(lines: np.ndarray, present: int) -> tuple[np.ndarray, np.ndarray]:
    """Log odds (present, nx, ny, nz) of the classes 1..present against the rest among all but the last, and
    the last one's probability (nx, ny, nz), from logits (nx, ny, C, nz); nz: whole vectors."""
    nx, ny, classes, nz = lines.shape
    odds, unsure = np.empty((present, nx, ny, nz), np.float32), np.empty((nx, ny, nz), np.float32)
    logits, out, shares = lines.reshape(-1), odds.reshape(-1), np.empty(classes * LANES, np.float32)
    uncertain, nodes = unsure.reshape(-1), nx * ny * nz
    least = every(np.float32(1e-9))  # keeps the logarithm finite
    for row in range(nx * ny):
        for v in range(0, nz, LANES):
            first = row * classes * nz + v
            highest = load(logits, first)
            for c in range(1, classes):
                highest = larger(highest, load(logits, first + c * nz))
            structure = every(np.float32(0))
            for c in range(classes - 1):
                share = exponential(minus(load(logits, first + c * nz), highest))
                structure = plus(structure, share)
                store(shares, c * LANES, share)
            share = exponential(minus(load(logits, first + (classes - 1) * nz), highest))
            store(uncertain, row * nz + v, over(share, plus(structure, share)))
            for k in range(present):
                mine = load(shares, (k + 1) * LANES)
                ratio = over(larger(mine, least), larger(minus(structure, mine), least))
                store(out, k * nodes + row * nz + v, logarithm(ratio))
    return odds, unsure


def _likely(odds: np.ndarray) -> np.ndarray:
    """Where coarse log odds (K, nx, ny, nz) do not rule each object out (K, nx, ny, nz)."""
    return np.stack(map_in_threads(beside, odds > SKIP_LOG_ODDS))


def _fine(coarse: Window | None) -> Window:
    """The nodes that coarse ones stand for; none for None."""
    if coarse is None:
        return slice(0, 0), slice(0, 0), slice(0, 0)
    x, y, z = (slice(COARSE * part.start, COARSE * part.stop) for part in coarse)
    return x, y, z
