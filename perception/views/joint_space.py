"""What several views say of space: free for one ray is free, occluded is what no view has seen.

Knows the spaces of single views and how their images are stacked; knows nothing of objects.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from mapping.compiled import compiled
from mapping.threads import Threads, map_in_threads
from perception.config import PerceptionConfig
from perception.observation import Observation
from perception.space import Region, Sight, Space, axes_of
from perception.views.joint import JointObservation, Stack

SHARED_FROM = 10_000
"""Points from which on threads share the views: fewer cost less than handing them over."""
Answer = TypeVar("Answer")
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
        sights = _of_each(lambda space: space.look(points), self.views, len(points))
        pixels, depths, behinds = (np.stack(part) for part in zip(*sights))
        stack = self.stack
        return Sight(
            *_most_told(
                pixels, depths, behinds, np.array(stack.rows), np.array(stack.widths), int(stack.width)
            )
        )

    def classify(self, points: np.ndarray) -> np.ndarray:
        """The Region of each point, (N,) int8: BELOW_SUPPORT, FREE, SURFACE, OCCLUDED, whichever comes
        first in any view, else OUT_OF_VIEW."""
        axes, parts = axes_of(points), [slice(0, len(points))]
        if len(points) >= SHARED_FROM:
            parts = Threads().split(len(points))
        found = map_in_threads(lambda part: self._classify(*(axis[part] for axis in axes)), parts)
        return np.concatenate([np.empty(0, np.int8), *found])

    def _classify(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        rank, asked = np.zeros(len(x), np.int8), np.arange(len(x))
        # Where all views have a support or none has, nothing outweighs "free".
        enough = RANK[Region.FREE] if len({space.has_support for space in self.views}) == 1 else np.int8(127)
        for space in self._on_floor:
            left = _raise(rank, asked, space.classify_axes(x, y, z), enough)
            if len(left) < len(asked):
                x, y, z, asked = x[left], y[left], z[left], asked[left]
        return np.asarray(REGION_OF_RANK[rank])

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


def _of_each(ask: Callable[[Space], Answer], views: Sequence[Space], count: int) -> list[Answer]:
    """What is asked of each view about so many points."""
    return map_in_threads(ask, views) if count >= SHARED_FROM else [ask(space) for space in views]


@compiled
def _most_told(
    pixels: np.ndarray,
    depths: np.ndarray,
    behinds: np.ndarray,
    rows: np.ndarray,
    widths: np.ndarray,
    width: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of what V views see on the rays through points, each (V, N), what the one says of each point that sees
    it nearest to its surface, or before it; where none measured anything, the first that has a pixel there.
    Pixels are those of the stacked image: rows, widths (V,) of the images in it."""
    views, count = pixels.shape
    pixel, depth, behind = np.empty(count, np.int32), np.empty(count, np.float32), np.empty(count, np.float32)
    for i in range(count):
        best, least = 0, np.float32(np.inf)
        for v in range(views):
            told = behinds[v, i]
            if np.isnan(told):
                told = np.float32(2e9) if pixels[v, i] < 0 else np.float32(1e9)
            if told < least:
                best, least = v, told
        own = pixels[best, i]
        if own >= 0:
            row = own // widths[best]
            own = np.int32((row + rows[best]) * width + own - row * widths[best])
        pixel[i], depth[i], behind[i] = own, depths[best, i], behinds[best, i]
    return pixel, depth, behind


@compiled
def _raise(rank: np.ndarray, asked: np.ndarray, regions: np.ndarray, enough: int) -> np.ndarray:
    """Raise the rank (N,) int8 of points asked (M,) to that of the regions (M,) which one more view gives
    them; and which of these (L,) have less than `enough`."""
    left, count = np.empty(len(asked), np.int64), 0
    for i in range(len(asked)):
        own = max(rank[asked[i]], RANK[regions[i]])
        rank[asked[i]] = own
        left[count] = i
        count += own < enough
    return left[:count]
