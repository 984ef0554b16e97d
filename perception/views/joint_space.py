"""What several views say of space: free for one ray is free, occluded is what no view has seen.

Knows the spaces of single views and how their images are stacked; knows nothing of objects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from perception.config import PerceptionConfig
from perception.observation import Observation
from perception.space import Region, Sight, Space
from perception.views.joint import JointObservation, Stack

RANK = np.array([4, 3, 2, 1, 5], np.int8)
"""By Region: what one view says of a point outweighs what says less."""
REGION_OF_RANK = np.array(
    [
        Region.OUT_OF_VIEW,
        Region.OUT_OF_VIEW,
        Region.OCCLUDED,
        Region.SURFACE,
        Region.FREE,
        Region.BELOW_SUPPORT,
    ],
    np.int8,
)


@dataclass(frozen=True)
class JointSpace(Space):
    """The space of several views in one table frame; answers as Space does.

    A point's pixel counts in the stacked image, and is that of the view that sees it nearest to its surface,
    or before it. camera, depth and T_camera_table are the first view's.
    """

    views: tuple[Space, ...] = ()
    stack: Stack = field(default_factory=lambda: Stack(0, (), ()))

    @classmethod
    def joined(cls, observation: JointObservation, config: PerceptionConfig | None = None) -> JointSpace:
        """The space that a joint observation shows."""
        views = tuple(Space.of(view.observation, config) for view in observation.views)
        first = views[0]
        guessed = None if observation.guess is None else np.isfinite(observation.guess)
        return cls(
            first.camera,
            first.depth,
            first.T_camera_table,
            first.has_support,
            first.config,
            guessed=guessed,
            views=views,
            stack=Stack.of([space.depth.shape for space in views]),
        )

    def look(self, points: np.ndarray) -> Sight:
        """What is seen on the ray through each point, from the view that tells most of it."""
        sights = [space.look(points) for space in self.views]
        behind = np.stack([sight.behind for sight in sights])
        # Where nothing was measured, a view that has a pixel there comes before one that has none.
        outside = np.stack([sight.pixel < 0 for sight in sights])
        rank = np.where(np.isnan(behind), np.where(outside, np.float32(2e9), np.float32(1e9)), behind)
        best, rows = rank.argmin(0), np.arange(len(points))
        pixel = np.stack([self.stack.place(view, sight.pixel) for view, sight in enumerate(sights)])
        depth = np.stack([sight.depth for sight in sights])
        return Sight(pixel[best, rows], depth[best, rows], behind[best, rows])

    def classify(self, points: np.ndarray) -> np.ndarray:
        """The Region of each point, (N,) int8: BELOW_SUPPORT, FREE, SURFACE, OCCLUDED, whichever comes
        first in any view, else OUT_OF_VIEW."""
        rank = np.zeros(len(points), np.int8)
        for space in self._on_floor:
            np.maximum(rank, RANK[space.classify(points)], out=rank)
        return REGION_OF_RANK[rank]

    def origin_of(self, pixels: np.ndarray) -> np.ndarray:
        """(N, 3) where the rays of pixels (N,) start [m]."""
        return np.stack([space.origin for space in self.views])[self.stack.view_of(pixels)]

    @cached_property
    def _on_floor(self) -> Sequence[Space]:
        return [replace(space, floor=self.floor) for space in self.views]


def space_of(observation: Observation, config: PerceptionConfig | None = None) -> Space:
    """The space of one view or of several."""
    if isinstance(observation, JointObservation):
        return JointSpace.joined(observation, config)
    return Space.of(observation, config)


def each_view(observation: Observation, space: Space) -> list[tuple[Observation, Space]]:
    """The observation and space of each view."""
    if isinstance(observation, JointObservation) and isinstance(space, JointSpace):
        return [(view.observation, own) for view, own in zip(observation.views, space.views)]
    return [(observation, space)]
