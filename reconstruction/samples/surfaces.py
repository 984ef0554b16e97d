"""Samples at seen surfaces: free in front, object right behind, and one within the wall.

Knows rays and the support plane; knows nothing of how thick a wall really is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapping.samples import shift_along_rays
from perception.space import Region
from reconstruction.samples.open_space import FOOT_CLEARANCE
from reconstruction.samples.scope import Scope


@dataclass(frozen=True)
class SurfaceSamples:
    """Samples (N, 3) before seen surfaces, right behind them, and in their walls.

    owner: (N,) class of each, 1 for the first object; flat: (N,) bool, the support plane comes before the
    wall's sample; guessed: (N,) bool, at a surface that was not measured but guessed; passed: (N,) bool,
    another view has seen that the wall ends before the wall's sample.
    """

    before: np.ndarray
    inside: np.ndarray
    wall: np.ndarray
    owner: np.ndarray
    flat: np.ndarray
    guessed: np.ndarray
    passed: np.ndarray


def surface_samples(scope: Scope) -> SurfaceSamples:
    """Samples around a subsample of every object's seen points. Nothing reaches into the table; what lies
    flat on it is filled down to it."""
    config = scope.config
    chosen = [scope.draws.subsample(item.points, item.pixels, config.surface_voxel) for item in scope.items]
    points = [item.points[rows] for item, rows in zip(scope.items, chosen)]
    pixels = [item.pixels[rows] for item, rows in zip(scope.items, chosen)]
    owner = np.repeat(scope.classes, [len(of_one) for of_one in points])
    measured = len(owner)
    for item, of_class in zip(scope.items, scope.classes):
        if len(item.guessed):
            rows = scope.draws.subsample(item.guessed_points, item.guessed, config.surface_voxel)
            points.append(item.guessed_points[rows])
            pixels.append(item.guessed[rows])
            owner = np.concatenate([owner, np.full(len(rows), of_class)])
    surface = np.concatenate(points)
    guessed = np.arange(len(surface)) >= measured
    offsets = (-config.pair_offset, config.pair_depth if config.pairs else 0.0, config.wall_depth)
    origin = scope.space.origin_of(np.concatenate(pixels))
    before, inside, wall = (shift_along_rays(origin, surface, offset) for offset in offsets)
    flat = np.zeros(len(wall), bool)
    if scope.supported:
        least = scope.floor + FOOT_CLEARANCE
        flat = wall[:, 2] < least
        inside[:, 2] = np.maximum(inside[:, 2], least)
        drop = inside[flat] - wall[flat]
        wall[flat] = inside[flat] - drop * ((inside[flat, 2:] - least) / drop[:, 2:])
    passed = scope.space.classify(wall) == Region.FREE
    return SurfaceSamples(before, inside, wall, owner, flat, guessed, passed)
