"""What is at a point: the map's answer, and what the frame itself says, which no map may contradict.

Knows the map, the observation and its space; knows nothing of meshes or files. What was
measured is never called free: the map is smooth, and may lean a few millimetres or a shadow too far.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mapping.checks import checked_points
from mapping.contramap import ContraMap
from perception.camera import invert_rigid, transform
from perception.observation import NOTHING, OTHER, SUPPORT, Observation
from perception.space import Sight, Space

EMPTY = 0
TOUCHING = 0.0015
"""From this depth before a measured surface on, a point is not seen to be free [m]."""
SURE_WALL = 0.003
"""What the map calls empty this little behind an object's measured surface belongs to the object [m]."""
OBSTACLE_WALL = 0.02
"""The same for obstacles without a label; what is deeper behind them is unknown [m]."""
FOOT = 0.005
"""Hidden space this close above a support is not known to be free: the support is known no better [m]."""
PIXEL_DEPTH = 0.01
"""At a rim, what is this little behind the nearest pixel's surface belongs to it [m]."""
GAP = 2
"""Pixels without depth this close to measured ones lie in a gap [px]."""
UNKNOWN = 0.5
"""Least p(uncertain) of what is called unknown."""
UNSEEN = 0.3
"""Least p(uncertain) of what is called empty where no ray passed: it is a guess, however likely."""


@dataclass(frozen=True)
class Query:
    """The map's answer at N points.

    label: (N,) int what is there: 0 empty, k > 0 the object with instance label k, -1 unknown (uncertain),
    -2 another obstacle (measured, but without a label), -3 a support, such as the table.
    occupancy: (N,) P(any object or other obstacle) among the classes other than uncertain; a support is
    neither; uncertainty: (N,) p(uncertain), at least 0.3 in what is empty only as a guess, for no ray passed
    there; gradient: (N, 3) d occupancy / d point [1/m] in the world frame.
    """

    label: np.ndarray
    occupancy: np.ndarray
    uncertainty: np.ndarray
    gradient: np.ndarray

    @property
    def free(self) -> np.ndarray:
        """(N,) bool: empty, and known to be."""
        return self.label == EMPTY


def ask(
    model: ContraMap, observation: Observation, space: Space, floor: float | None, points: np.ndarray
) -> Query:
    """The answer at points (N, 3) float32 [m] in the table frame; the gradient is in that frame as well.

    floor: height [m] below which no object can be, None if unknown.
    """
    probability, occupancy, gradient = model.predict_occupancy(points)
    labels = [item.label for item in observation.objects]
    # Columns follow the observed objects, one of which may have got no mesh.
    others = [OTHER] * (probability.shape[1] - 2 - len(labels))
    label = np.array([EMPTY, *labels, *others, NOTHING])[probability.argmax(1)]
    uncertainty = probability[:, -1].copy()
    answer = Query(label, occupancy, uncertainty, gradient)
    if observation.seen is not None:
        _mind_what_was_seen(answer, observation, space, floor, points)
    return answer


def ask_world(
    model: ContraMap,
    observation: Observation,
    space: Space,
    floor: float | None,
    T_world_table: np.ndarray,
    points: np.ndarray,
) -> Query:
    """The answer at points (N, 3) [m] in the world frame, the gradient in that frame; T_world_table: (4, 4).

    Raises DataError for points of another shape, NaN and infinite values.
    """
    checked_points(points, dimensions=3)
    # In double precision: world frames may have their origin thousands of kilometres away.
    local = transform(invert_rigid(T_world_table), np.asarray(points, np.float64)).astype(np.float32)
    found = ask(model, observation, space, floor, local)
    return replace(found, gradient=found.gradient @ T_world_table[:3, :3].T.astype(np.float32))


def _mind_what_was_seen(
    answer: Query, observation: Observation, space: Space, floor: float | None, points: np.ndarray
) -> None:
    """Correct an answer, in place, where the frame says better."""
    label = answer.label
    sight = space.look(points)
    assert observation.seen is not None
    seen = np.where(sight.pixel >= 0, observation.seen.reshape(-1)[sight.pixel], NOTHING)
    # A guessed depth is no measurement: comparisons with NaN are false.
    behind = np.where(seen == NOTHING, np.float32(np.nan), sight.behind)
    hit = behind >= -TOUCHING
    support = np.zeros(len(points), bool)
    if floor is not None:
        below = points[:, 2] < floor
        support |= below & hit
        label[below & ~hit & (label > 0)] = EMPTY
        unseen = below & np.isnan(behind)
        label[unseen] = NOTHING
        lowest = min(item.floor for item in observation.objects)
        for item in observation.objects:
            support |= (label == item.label) & (points[:, 2] < item.floor + floor - lowest)
        # Where no ray went, the lowest millimetres are the support's, or a hidden foot's.
        sunk = points[:, 2] < _floor_seen(observation, seen) + (floor - lowest) + FOOT
        support |= (label == EMPTY) & hit & sunk
        label[(label == EMPTY) & np.isnan(behind) & (points[:, 2] < floor + FOOT)] = NOTHING
    blind = (sight.pixel >= 0) & np.isnan(behind) & (label == EMPTY)
    if blind.any():
        # A gap in the depth image is known to be free no further than the nearest thing around it.
        nearest = _nearest(observation, np.isfinite(observation.depth), GAP)
        label[blind & (sight.depth > nearest[sight.pixel] - TOUCHING)] = NOTHING
    # Beyond the image's border nothing was seen to be free, whatever the map makes of it.
    label[(sight.pixel < 0) & (label == EMPTY)] = NOTHING
    empty = label == EMPTY
    support |= empty & hit & (seen == SUPPORT)
    # Flat things without a label pass for their support: their rims, too.
    support |= empty & (seen == SUPPORT) & _at_rim(observation, sight, SUPPORT)
    beside = empty & _at_rim(observation, sight, OTHER)
    label[beside] = OTHER
    empty &= ~beside
    wall = empty & hit & (seen > 0) & (behind < SURE_WALL)
    label[wall] = seen[wall]
    obstacle = empty & hit & (seen == OTHER)
    near = obstacle & (behind < OBSTACLE_WALL)
    label[near] = OTHER
    label[obstacle & ~near] = NOTHING
    label[support] = SUPPORT
    hidden = (label == EMPTY) & ~(behind < -TOUCHING)  # behind something, or in a gap of the depth image
    answer.uncertainty[hidden] = UNSEEN + (1 - UNSEEN) * answer.uncertainty[hidden]
    unknown = label == NOTHING
    answer.uncertainty[unknown] = np.maximum(answer.uncertainty[unknown], UNKNOWN)
    near |= beside
    answer.occupancy[wall | near] = np.maximum(answer.occupancy[wall | near], 0.5)
    answer.occupancy[support] = 0
    answer.gradient[support] = 0


def _floor_seen(observation: Observation, seen: np.ndarray) -> np.ndarray:
    """Height (N,) [m] of the support under what each point's pixel sees; the lowest one where it is none."""
    lowest = min(item.floor for item in observation.objects)
    height = np.full(len(seen), lowest, np.float32)
    for item in observation.objects:
        if item.floor > lowest:
            height[seen == item.label] = item.floor
    return height


def _at_rim(observation: Observation, sight: Sight, kind: int) -> np.ndarray:
    """Which points (N,) lie at the depth of an obstacle, or support, that one of the pixels around theirs
    sees: rims are known to a pixel, and the pixel at a rim is often without depth."""
    assert observation.seen is not None
    gap = sight.depth - _nearest(observation, np.asarray(observation.seen == kind), 1)[sight.pixel]
    return (sight.pixel >= 0) & (gap > -TOUCHING) & (gap < PIXEL_DEPTH)


def _nearest(observation: Observation, of: np.ndarray, reach: int) -> np.ndarray:
    """(H W,) the least depth [m] measured at pixels of a mask (H, W) within `reach` [px] of each pixel."""
    import cv2

    depth = np.where(of & np.isfinite(observation.depth), observation.depth, np.float32(np.inf))
    return cv2.erode(depth, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)).reshape(-1)
