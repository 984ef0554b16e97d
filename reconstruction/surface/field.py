"""The map on one lattice over the scene: evaluated in blocks, only where an object can be.

Knows a fitted map whose class 0 is empty space; knows nothing of frames or meshes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy import ndimage

from mapping.compiled import compiled
from mapping.contramap import ContraMap
from mapping.threads import map_in_threads

BLOCK = 40
"""Nodes a side of the blocks that are evaluated at a time, as far as objects' windows reach into them."""
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
    against the rest among the non-uncertain classes;
    uncertainty: (nx, ny, nz) float32 p(uncertain), 1 outside all windows.
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


def around(windows: list[Window]) -> Window:
    """The smallest window that holds all of some windows."""
    x, y, z = (slice(min(s.start for s in part), max(s.stop for s in part)) for part in zip(*windows))
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
    shape = tuple(int(n) for n in count * BLOCK)
    boxes = [window_of(origin, spacing, shape, *box) for box in zip(lows, highs)]
    windows = [overlap(*pair) for pair in zip(boxes, _where_likely((coarse[own] - coarse[0]).cpu().numpy()))]
    log_odds = [np.full([w.stop - w.start for w in window], OUTSIDE, np.float32) for window in windows]
    uncertainty = np.ones(shape, np.float32)
    lattice = evaluator.on(axes)
    # A steep ramp rather than a step: the surface is to end at the floor, not half a cell from it.
    ramps = [FLOOR_SLOPE * (axes[2] - floor).astype(np.float32) for floor in floors or ()]

    def fill(block: tuple[int, ...]) -> None:
        x, y, z = (slice(b * BLOCK, (b + 1) * BLOCK) for b in block)
        parts = {k: overlap((x, y, z), window) for k, window in enumerate(windows)}
        parts = {k: part for k, part in parts.items() if all(p.stop > p.start for p in part)}
        if not parts:
            return
        evaluated = around(list(parts.values()))
        present = list(parts) if confined else list(range(len(windows)))
        columns = [0, *(own[k] for k in present), *rivals, last]
        logits = lattice.block(evaluated, torch.tensor(columns, device=coarse.device))
        share = logits.sub_(logits.amax(0)).exp_()
        structure = share[:-1].sum(0)
        uncertainty[evaluated] = (share[-1] / (structure + share[-1])).cpu().numpy()
        # P(k) against the rest among the non-uncertain classes; 1e-9 keeps the logarithm finite.
        mine = share[1 : len(present) + 1]
        others = (structure - mine).clamp_min_(1e-9)
        odds = mine.clamp_min_(1e-9).div_(others).log_().cpu().numpy()
        for k, of_one in zip(present, odds):
            if k in parts:
                if ramps:
                    np.minimum(of_one, ramps[k][evaluated[2]], out=of_one)
                log_odds[k][within(parts[k], windows[k])] = of_one[within(parts[k], evaluated)]

    map_in_threads(fill, np.ndindex(*count))
    return Field(origin, spacing, windows, log_odds, uncertainty)


def _where_likely(odds: np.ndarray) -> list[Window]:
    """For each object the nodes where coarse log odds (K, nx, ny, nz) do not rule it out."""
    likely = ndimage.maximum_filter(odds, size=(1, 3, 3, 3)) > SKIP_LOG_ODDS
    found: list[Window] = []
    for of_one in likely:
        box = ndimage.find_objects(of_one.astype(np.int8))
        coarse = box[0] if box else (slice(0, 0),) * 3
        x, y, z = (slice(COARSE * s.start, COARSE * s.stop) for s in coarse)
        found.append((x, y, z))
    return found
