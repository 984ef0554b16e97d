"""The map on one lattice over the scene: evaluated in blocks, only where an object can be.

Knows a fitted map whose class 0 is empty space; knows nothing of frames or meshes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy import ndimage

from mapping.contramap import ContraMap

BLOCK = 16
"""Nodes a side of a block that is evaluated or skipped as a whole."""
COARSE = 4
"""The first pass looks at every 4th node."""
SKIP_LOG_ODDS = -4.0
"""A block is skipped when every coarse node in or beside it has log odds of "object" below this."""
OUTSIDE = -20.0
"""Log odds given to nodes of skipped blocks."""


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


def evaluate_field(model: ContraMap, low: np.ndarray, high: np.ndarray, spacing: float) -> Field:
    """Evaluate a map on a lattice of `spacing` [m] that covers the box low..high (3,) [m]."""
    count = np.ceil((np.asarray(high) - low) / (spacing * BLOCK)).astype(int)
    # Multiples of the spacing: the same place is sampled alike whatever else is in the scene.
    origin = np.floor(np.asarray(low) / spacing) * spacing
    axes = [origin[i] + spacing * np.arange(count[i] * BLOCK) for i in range(3)]
    coarse = model.lattice_logits(tuple(axis[::COARSE] for axis in axes))
    any_object = _log_odds_of_rest(coarse)
    wide = ndimage.maximum_filter(any_object.cpu().numpy(), size=3)
    step = BLOCK // COARSE
    peak = wide.reshape(count[0], step, count[1], step, count[2], step).max(axis=(1, 3, 5))
    objects = model.class_count - 2
    shape = tuple(count * BLOCK)
    log_odds = np.full((objects, *shape), OUTSIDE, np.float32)
    uncertainty = np.ones(shape, np.float32)
    for block in np.argwhere(peak > SKIP_LOG_ODDS):
        window = tuple(slice(b * BLOCK, (b + 1) * BLOCK) for b in block)
        logits = model.lattice_logits(tuple(axis[w] for axis, w in zip(axes, window)))
        structure = logits[..., :-1]
        # P(k) / (1 - P(k)) among the non-uncertain classes; float32 is exact enough away from 0 and 1.
        p = torch.softmax(structure, -1)[..., 1:].clamp(1e-7, 1 - 1e-6)
        log_odds[(slice(None), *window)] = torch.logit(p).permute(3, 0, 1, 2).cpu().numpy()
        uncertainty[window] = torch.softmax(logits, -1)[..., -1].cpu().numpy()
    return Field(origin, spacing, log_odds, uncertainty)


def _log_odds_of_rest(logits: torch.Tensor) -> torch.Tensor:
    """Log odds of "any object" against "empty" for logits (..., C+1)."""
    return torch.logsumexp(logits[..., 1:-1], -1) - logits[..., 0]
