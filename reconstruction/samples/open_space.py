"""Samples away from surfaces: free, hidden, below the support plane, and under objects' hidden feet.

Knows what rays say of places; knows nothing of what may fill the hidden ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapping.hinges import lattice_near_points
from perception.observation import SUPPORT
from perception.space import Region
from reconstruction.samples.reach_down import visible_end
from reconstruction.samples.scope import Scope

FOOT_CLEARANCE = 0.0015
"""Samples keep this distance from the support plane, which is known no better [m]."""
LEVEL = np.array([1, 1, 0], np.float32)
"""Drops points on the support plane."""
DEEPER_SHARE = 0.3
"""As many more samples, as a share of those right under a foot, lie deeper."""
DEEPER = (0.005, 0.020)
"""How deep under the support plane [m]."""


@dataclass(frozen=True)
class OpenSpace:
    """Samples (N, 3) of each kind. empty: known to be; free: those of them away from objects."""

    free: np.ndarray
    hidden: np.ndarray
    empty: np.ndarray


def open_space(scope: Scope) -> OpenSpace:
    """Samples of free space away from objects, of hidden space, and all that are known to be empty."""
    config = scope.config
    free = scope.cover(config.free_spacing)
    free = free[scope.space.classify(free) == Region.FREE]
    hidden = scope.cover(config.occluded_spacing)
    region = scope.space.classify(hidden)
    # Where nothing was measured beside an object, the kernels would let it grow unchecked.
    unknown = region == Region.OUT_OF_VIEW
    unknown[unknown] = scope.near(hidden[unknown], config.unknown_distance)
    hidden = hidden[(region == Region.OCCLUDED) | unknown]
    seen = scope.seen_nodes(config.near_spacing)
    near = lattice_near_points(seen, config.near_distance, config.near_spacing)
    near = scope.draws.jitter(near, config.near_spacing)
    is_empty, is_hidden = scope.classify(near)
    hidden = np.concatenate([hidden, near[is_hidden], _beyond_border(scope)])
    hidden = hidden[~_within_wall(scope, hidden)]
    return OpenSpace(free, hidden, np.concatenate([free, near[is_empty]]))


def _beyond_border(scope: Scope) -> np.ndarray:
    """Samples (M, 3) outside the image around objects that its border cuts: as dense as near seen surfaces,
    for nothing but samples says what goes on there."""
    config = scope.config
    parts = [np.empty((0, 3), np.float32)]
    for item in scope.items:
        if scope.observation.at_border(item):
            low, high = item.bounds
            low = np.maximum(low - config.unknown_distance, [-np.inf, -np.inf, scope.floor])
            points = scope.draws.lattice(low, high + config.unknown_distance, config.near_spacing)
            parts.append(points[(scope.space.pixel_of(points) < 0) & (points[:, 2] > low[2])])
    return np.concatenate(parts)


def below_support(scope: Scope) -> np.ndarray:
    """Samples (M, 3) under the support plane: a dense layer right under it, a coarse one deeper."""
    config = scope.config
    layers = []
    for top, bottom, spacing in (
        (0.0, -config.pair_offset, config.floor_spacing),
        (-config.pair_offset, -config.below_depth, config.below_spacing),
    ):
        top, bottom = scope.floor + top, scope.floor + bottom
        layer = np.array([*scope.low[:2], bottom]), np.array([*scope.high[:2], top])
        points = scope.cover(spacing, *layer)
        layers.append(points[(points[:, 2] < top) & (points[:, 2] >= np.float32(bottom))])
    below = np.concatenate(layers)
    return below if len(scope.observation.levels) == 1 else below[_under_own_support(scope, below)]


def feet(scope: Scope) -> np.ndarray:
    """Samples (M, 3) under the support plane where an object may stand unseen, most of them right under it:
    they close the objects' bottoms."""
    config = scope.config
    points = scope.draws.lattice(scope.low * LEVEL, scope.high * LEVEL, config.foot_spacing)
    points[:, 2] += scope.floor
    points = points[scope.near(points, config.foot_distance) | _under_hovering(scope, points)]
    points[:, 2] = scope.floor + FOOT_CLEARANCE
    points = points[scope.space.classify(points) != Region.FREE]
    deeper = points[scope.draws.chance(points, 0) < DEEPER_SHARE]
    points[:, 2] = scope.floor - FOOT_CLEARANCE
    least, most = DEEPER
    deeper[:, 2] = scope.floor - (least + (most - least) * scope.draws.chance(deeper, 1))
    return np.concatenate([points, deeper])


def _under_hovering(scope: Scope, points: np.ndarray) -> np.ndarray:
    """Which points (N, 3) on the support lie under an object whose visible part ends high above it, or beyond
    the image's border that cuts one."""
    under = np.zeros(len(points), bool)
    for item in scope.items:
        low, high = item.bounds
        if visible_end(item, scope.space) - scope.floor > scope.config.foot_distance:
            reach = scope.config.foot_distance
            under |= ((points[:, :2] > low[:2] - reach) & (points[:, :2] < high[:2] + reach)).all(1)
        if scope.observation.at_border(item):
            reach = scope.config.unknown_distance
            beside = ((points[:, :2] > low[:2] - reach) & (points[:, :2] < high[:2] + reach)).all(1)
            under |= beside & (scope.space.pixel_of(points) < 0)
    return under


def _under_own_support(scope: Scope, points: np.ndarray) -> np.ndarray:
    """Of points (N, 3) under a support that is one of several, those where its surface is seen above, or an
    object stands on it: beside a board or a tray, its height means nothing."""
    top = points.copy()
    top[:, 2] = scope.floor
    pixel = scope.space.pixel_of(top)
    seen = scope.observation.seen
    assert seen is not None
    on_surface = (seen.reshape(-1)[pixel] == SUPPORT) & (pixel >= 0)
    on_surface &= scope.space.classify(top) == Region.SURFACE
    return on_surface | scope.near(top, scope.config.foot_distance)


def _within_wall(scope: Scope, points: np.ndarray) -> np.ndarray:
    """Which points (N, 3) lie so little behind an object's seen surface that they belong to its wall."""
    sight = scope.space.look(points)
    within = (sight.pixel >= 0) & (sight.behind < scope.config.wall)
    within[within] = scope.observation.shows_object(sight.pixel[within])
    return np.asarray(within)
