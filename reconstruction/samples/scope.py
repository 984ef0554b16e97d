"""What every kind of sample starts from: an observation, its space, the settings, and the box to cover.

Knows where samples may lie; knows nothing of their labels. Objects that are far from each other, or stand on
different supports, have scopes of their own: what is between them costs nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mapping.hinges import lattice_near_points
from perception.observation import Observation, ObservedObject, near_boxes
from perception.space import Region, Space
from perception.views.joint import JointObservation
from reconstruction.config import TabletopSamples
from reconstruction.samples.draws import Draws, draws_of


@dataclass(frozen=True)
class Scope:
    """Some objects of one observation to draw samples around.

    classes: class of each of items, 1 for the observation's first object; seen: (N, 3) their visible surface
    [m, table frame]; low, high: (3,) corners of the box to cover; floor: height of their support [m].
    """

    observation: Observation
    space: Space
    config: TabletopSamples
    rng: np.random.Generator
    draws: Draws
    items: tuple[ObservedObject, ...]
    classes: tuple[int, ...]
    seen: np.ndarray
    low: np.ndarray
    high: np.ndarray
    floor: float

    @classmethod
    def all_of(
        cls, observation: Observation, space: Space, config: TabletopSamples, rng: np.random.Generator
    ) -> list[Scope]:
        """Scopes for all objects: each the box around its objects, no deeper than their support."""
        scopes, draws = [], draws_of(space, rng)
        for group in groups(observation, config.radius, config.radius_share):
            items = tuple(observation.objects[index] for index in group)
            seen = np.concatenate([item.outline for item in items])
            radius = max(item.reach(config.radius, config.radius_share) for item in items)
            lows, highs = zip(*(item.bounds for item in items))
            low, high = np.min(lows, 0) - radius, np.max(highs, 0) + radius
            floor = items[0].floor
            if observation.support is not None:
                low[2] = floor
            own = space if floor == space.floor else replace(space, floor=floor)
            classes = tuple(index + 1 for index in group)
            scopes.append(cls(observation, own, config, rng, draws, items, classes, seen, low, high, floor))
        return scopes

    @property
    def supported(self) -> bool:
        """Whether a support plane was found: nothing of an object is below `floor`."""
        return self.observation.support is not None

    def seen_nodes(self, spacing: float) -> np.ndarray:
        """Points (M, 3) in the same cells around multiples of `spacing` as what is seen; of several views,
        one a cell and view, which is worked out once."""
        if not isinstance(self.observation, JointObservation):
            return self.seen
        labels, nodes = {item.label for item in self.items}, [item.guessed_points for item in self.items]
        for view in self.observation.views:
            own = [item for item in view.observation.objects if item.label in labels]
            known = view.observation.memo.setdefault(("nodes", spacing), {})
            which = tuple(item.label for item in own)
            if own and which not in known:
                known[which] = lattice_near_points(
                    np.concatenate([item.points for item in own]), 0.0, spacing
                )
            nodes += [known[which]] if own else []
        return np.concatenate(nodes)

    def near(self, points: np.ndarray, distance: float, share: float = 0.0) -> np.ndarray:
        """Which points (N, 3) lie near one of the scope's objects' boxes: (N,) bool.

        Near is within `distance` [m], or within `share` of the object's visible width where that is more.
        """
        reaches = [item.reach(distance, share) for item in self.items]
        return near_boxes(points, [item.bounds for item in self.items], reaches)

    def cover(
        self, spacing: float, low: np.ndarray | None = None, high: np.ndarray | None = None
    ) -> np.ndarray:
        """Jittered samples (M, 3) of a box, the whole one by default, within `radius` of an object's box."""
        low, high = self.low if low is None else low, self.high if high is None else high
        points = self.draws.lattice(low, high, spacing)
        return points[self.near(points, self.config.radius, self.config.radius_share)]

    def classify(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which points (N, 3) are known to be empty, and which are hidden: (N,) bool each."""
        region = self.space.classify(points)
        empty = (region == Region.FREE) | (region == Region.BELOW_SUPPORT)
        return empty, (region == Region.OCCLUDED) | (region == Region.OUT_OF_VIEW)


def groups(observation: Observation, radius: float, share: float = 0.0) -> list[list[int]]:
    """Indices of the objects in groups of one support whose surroundings meet: `radius` [m] wide, or `share`
    of an object's visible width where that is more."""
    objects = observation.objects
    group = list(range(len(objects)))
    for b, item in enumerate(objects):
        low, high = item.bounds
        for a, other in enumerate(objects[:b]):
            gap = max((other.bounds[0] - high).max(), (low - other.bounds[1]).max())
            if item.floor == other.floor and gap < item.reach(radius, share) + other.reach(radius, share):
                group = [group[a] if of == group[b] else of for of in group]
    return [[k for k, of in enumerate(group) if of == name] for name in dict.fromkeys(group)]
