"""Obstacles: what was measured near objects and carries no label. One class of the map, "other".

Knows where such surfaces were seen; knows nothing of what they belong to. What lies behind them is unknown:
some of it is theirs, and none of it is free.
"""

from __future__ import annotations

import numpy as np

from mapping.samples import shift_along_rays, voxel_subsample, within
from perception.observation import Observation, near_boxes
from perception.space import Space

LEAST_POINTS = 30
"""Fewer measured points than this make no class of their own."""
VOXEL = 0.012
"""Voxel that keeps one surface pair of an obstacle [m]."""
OFFSETS = (-0.003, 0.002, 0.009)
"""Samples before, right behind and further behind an obstacle's surface [m]."""
DOUBTS = (0.0, 0.0, 0.4)
"""The chance that each of them is something else."""
IN_SHELL = 0.9
"""Chance that hidden space right behind an obstacle's surface is its own."""
BEYOND = 0.4
"""The same deeper behind it: less than half, so that the map is unsure of it and claims none of it."""
REACH = 0.15
"""An obstacle's hidden part may reach this far beside what is seen of it [m]."""
BESIDE = 0.3
"""The same of hidden space that is beside what is seen of it: behind other things."""
TOUCHING = -0.002
"""Depth behind a surface from which on a point counts as behind it [m]."""


def near_obstacles(observation: Observation, radius: float) -> np.ndarray:
    """Thinned surface points (M, 3) [m] of obstacles within `radius` [m] of objects; none if few.

    Rims that tight masks leave over are none: what was measured there is known to the frame, and they hide
    nothing that their object does not.
    """
    points = observation.other.points[observation.other.bulky]
    points = points[observation.near_objects(points, radius)]
    return points[voxel_subsample(points, VOXEL)] if len(points) >= LEAST_POINTS else points[:0]


def obstacle_samples(points: np.ndarray, origin: np.ndarray) -> list[tuple[np.ndarray, bool, float]]:
    """Samples (M, 3) before and behind surface points (M, 3): each set with whether it is the obstacle's own,
    and with the chance that it is not what it seems. origin: (3,) or (M, 3) where the rays start."""
    return [
        (shift_along_rays(origin, points, offset), offset > 0, doubt)
        for offset, doubt in zip(OFFSETS, DOUBTS)
    ]


def with_obstacles(
    observation: Observation,
    space: Space,
    shell: float,
    points: np.ndarray,
    guess: np.ndarray,
    obstacles: np.ndarray,
) -> np.ndarray:
    """Guesses (N, K+1) of hidden points with a column (N, 1) more for obstacles (M, 3), if there are any: it
    takes from "empty", never from an object. shell: how thick an obstacle is at least [m]."""
    if len(obstacles) == 0:
        return guess
    wide = np.zeros(observation.depth.size, bool)
    wide[observation.other.pixels[observation.other.bulky]] = True
    sight = space.look(points)
    behind = wide[sight.pixel] & (sight.pixel >= 0)
    behind &= sight.behind > TOUCHING
    lean = np.zeros(len(points), np.float32)
    box = near_boxes(points, [(obstacles.min(0), obstacles.max(0))], [REACH])  # most are far: no search
    beside = np.flatnonzero(box & ~behind)
    lean[beside[within(points[beside], obstacles, REACH)]] = BESIDE
    lean[behind] = BEYOND
    lean[behind & (sight.behind < shell)] = IN_SHELL
    other = guess[:, 0] * lean
    guess[:, 0] -= other
    return np.column_stack([guess, other])
