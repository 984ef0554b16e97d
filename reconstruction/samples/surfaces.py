"""Samples at seen surfaces: free in front, object right behind, and one within the wall.

Knows rays and the support plane; knows nothing of how thick a wall really is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapping.samples import shift_along_rays, voxel_subsample
from reconstruction.samples.open_space import FOOT_CLEARANCE
from reconstruction.samples.scope import Scope


@dataclass(frozen=True)
class SurfaceSamples:
    """Samples (N, 3) before seen surfaces, right behind them, and in their walls.

    owner: (N,) class of each, 1 for the first object; flat: (N,) bool, the support plane comes before the
    wall's sample.
    """

    before: np.ndarray
    inside: np.ndarray
    wall: np.ndarray
    owner: np.ndarray
    flat: np.ndarray


def surface_samples(scope: Scope) -> SurfaceSamples:
    """Samples around a subsample of every object's seen points. Nothing reaches into the table; what lies
    flat on it is filled down to it."""
    config = scope.config
    points = [
        item.points[voxel_subsample(item.points, config.surface_voxel, scope.rng)]
        for item in scope.observation.objects
    ]
    owner = np.repeat(np.arange(len(points)), [len(of_one) for of_one in points]) + 1
    surface = np.concatenate(points)
    offsets = (-config.pair_offset, config.pair_depth if config.pairs else 0.0, config.wall_depth)
    before, inside, wall = (shift_along_rays(scope.space.origin, surface, offset) for offset in offsets)
    flat = np.zeros(len(wall), bool)
    if scope.supported:
        flat = wall[:, 2] < FOOT_CLEARANCE
        inside[:, 2] = np.maximum(inside[:, 2], FOOT_CLEARANCE)
        drop = inside[flat] - wall[flat]
        wall[flat] = inside[flat] - drop * ((inside[flat, 2:] - FOOT_CLEARANCE) / drop[:, 2:])
    return SurfaceSamples(before, inside, wall, owner, flat)
