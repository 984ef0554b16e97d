"""The map on one lattice over the scene: evaluated in blocks, only where an object can be.

Knows a fitted map whose class 0 is empty space; knows nothing of frames or meshes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy import ndimage

from mapping.contramap import ContraMap
from mapping.threads import map_in_threads

BLOCK = 24
"""Nodes a side of a block that is evaluated or skipped as a whole."""
COARSE = 4
"""The first pass looks at every 4th node."""
SKIP_LOG_ODDS = -4.0
"""A block is skipped when every coarse node in or beside it has log odds of "object" below this."""
OUTSIDE = -20.0
"""Log odds given to nodes of skipped blocks."""
FLOOR_SLOPE = 2000.0
"""Log odds [1/m] may rise this steeply above the floor."""


@dataclass(frozen=True)
class Field:
    """Log odds and uncertainty on the lattice origin + spacing * (i, j, k), in the map's frame.

    log_odds: (K, nx, ny, nz) float32, object k against the rest among the non-uncertain classes;
    uncertainty: (nx, ny, nz) float32 p(uncertain), 1 in skipped blocks.
    """

    origin: np.ndarray
    spacing: float
    log_odds: np.ndarray
    uncertainty: np.ndarray

    def window(self, low: np.ndarray, high: np.ndarray, pad: int = 0) -> tuple[slice, slice, slice]:
        """Index ranges of the nodes that cover the box low..high (3,) [m] and `pad` nodes around it."""
        limit = np.array(self.uncertainty.shape)
        first = np.clip(np.floor((low - self.origin) / self.spacing).astype(int) - pad, 0, limit)
        last = np.clip(np.ceil((high - self.origin) / self.spacing).astype(int) + 1 + pad, 0, limit)
        x, y, z = (slice(int(a), int(b)) for a, b in zip(first, last))
        return x, y, z


def evaluate_field(
    model: ContraMap,
    lows: np.ndarray,
    highs: np.ndarray,
    spacing: float,
    floor: float | None = None,
    confined: bool = True,
) -> Field:
    """Evaluate a map on one lattice of `spacing` [m] over boxes lows..highs (K, 3) [m].

    Blocks that touch no box, or that the map knows to be empty, are skipped. floor: no object is below this
    height [m]. confined: blocks that an object's box does not touch are evaluated as if it did not exist.
    """
    low, high = lows.min(0), highs.max(0)
    count = np.ceil((np.asarray(high) - low) / (spacing * BLOCK)).astype(int)
    # Multiples of the spacing: the same place is sampled alike whatever else is in the scene.
    origin = np.floor(np.asarray(low) / spacing) * spacing
    axes = [origin[i] + spacing * np.arange(count[i] * BLOCK) for i in range(3)]
    evaluator = model.lattice()
    coarse = evaluator([axis[::COARSE] for axis in axes])
    any_object = torch.logsumexp(coarse[1:-1], 0) - coarse[0]
    wide = ndimage.maximum_filter(any_object.cpu().numpy(), size=3)
    step = BLOCK // COARSE
    peak = wide.reshape(count[0], step, count[1], step, count[2], step).max(axis=(1, 3, 5))
    objects = model.class_count - 2
    shape = tuple(count * BLOCK)
    log_odds = np.full((objects, *shape), OUTSIDE, np.float32)
    uncertainty = np.ones(shape, np.float32)
    side = spacing * BLOCK
    lattice = evaluator.on(axes)
    # A steep ramp rather than a step: the surface is to end at the floor, not half a cell from it.
    ramp = np.full(shape[2], np.inf) if floor is None else FLOOR_SLOPE * (axes[2] - floor)
    ramp = ramp.astype(np.float32)

    def fill(block: np.ndarray) -> None:
        corner = origin + side * block
        present = np.all((corner <= highs) & (corner + side >= lows), axis=1)
        if not present.any():
            return
        present = np.flatnonzero(present | (not confined))
        x, y, z = window = tuple(slice(b * BLOCK, (b + 1) * BLOCK) for b in block)
        classes = torch.from_numpy(np.concatenate([[0], present + 1, [objects + 1]])).to(coarse.device)
        logits = lattice.block(window, classes)
        share = logits.sub_(logits.amax(0)).exp_()
        structure = share[:-1].sum(0)
        uncertainty[window] = (share[-1] / (structure + share[-1])).cpu().numpy()
        # P(k) against the rest among the non-uncertain classes; 1e-9 keeps the logarithm finite.
        others = (structure - share[1:-1]).clamp_min_(1e-9)
        odds = share[1:-1].clamp_min_(1e-9).div_(others).log_().cpu().numpy()
        log_odds[present, x, y, z] = np.minimum(odds, ramp[z], out=odds)

    map_in_threads(fill, np.argwhere(peak > SKIP_LOG_ODDS))
    return Field(origin, spacing, log_odds, uncertainty)
