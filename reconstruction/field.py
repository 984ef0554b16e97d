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
    model: ContraMap, lows: np.ndarray, highs: np.ndarray, spacing: float, floor: float | None = None
) -> Field:
    """Evaluate a map on one lattice of `spacing` [m] over boxes lows..highs (K, 3) [m].

    Blocks that touch no box, or that the map knows to be empty, are skipped. floor: no object is below this
    height [m].
    """
    low, high = lows.min(0), highs.max(0)
    count = np.ceil((np.asarray(high) - low) / (spacing * BLOCK)).astype(int)
    # Multiples of the spacing: the same place is sampled alike whatever else is in the scene.
    origin = np.floor(np.asarray(low) / spacing) * spacing
    axes = [origin[i] + spacing * np.arange(count[i] * BLOCK) for i in range(3)]
    evaluate = model.lattice()
    coarse = evaluate([axis[::COARSE] for axis in axes])
    any_object = torch.logsumexp(coarse[1:-1], 0) - coarse[0]
    wide = ndimage.maximum_filter(any_object.cpu().numpy(), size=3)
    step = BLOCK // COARSE
    peak = wide.reshape(count[0], step, count[1], step, count[2], step).max(axis=(1, 3, 5))
    objects = model.class_count - 2
    shape = tuple(count * BLOCK)
    log_odds = np.full((objects, *shape), OUTSIDE, np.float32)
    uncertainty = np.ones(shape, np.float32)
    side = spacing * BLOCK

    def fill(block: np.ndarray) -> None:
        window = tuple(slice(b * BLOCK, (b + 1) * BLOCK) for b in block)
        logits = evaluate([axis[w] for axis, w in zip(axes, window)])
        share = (logits - logits.amax(0)).exp_()
        total = share.sum(0)
        uncertainty[window] = (share[-1] / total).cpu().numpy()
        # P(k) against the rest among the non-uncertain classes; the floor keeps the logarithm finite.
        structure = total - share[-1]
        others = (structure - share[1:-1]).clamp_min_(1e-9)
        log_odds[(slice(None), *window)] = (share[1:-1].clamp_min(1e-9) / others).log_().cpu().numpy()
        heights = axes[2][window[2]]
        if floor is not None and heights[0] < floor + spacing:
            # A steep ramp rather than a step: the surface is to end at the floor, not half a cell from it.
            odds = log_odds[(slice(None), *window)]
            np.minimum(odds, (FLOOR_SLOPE * (heights - floor)).astype(np.float32), out=odds)

    corners = origin + side * np.argwhere(peak > SKIP_LOG_ODDS)
    touched = (corners[:, None] <= highs) & (corners[:, None] + side >= lows)
    map_in_threads(fill, np.argwhere(peak > SKIP_LOG_ODDS)[np.any(np.all(touched, axis=2), axis=1)])
    return Field(origin, spacing, log_odds, uncertainty)
