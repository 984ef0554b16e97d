"""What every kind of sample starts from: one observation, its space, the settings, and the box to cover.

Knows where samples may lie; knows nothing of their labels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapping.samples import jittered_lattice
from perception.observation import Observation
from perception.space import Region, Space
from reconstruction.config import TabletopSamples


@dataclass(frozen=True)
class Scope:
    """One observation to draw samples of.

    seen: (N, 3) all objects' seen points [m, table frame]; low, high: (3,) corners of the box to cover.
    """

    observation: Observation
    space: Space
    config: TabletopSamples
    rng: np.random.Generator
    seen: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @classmethod
    def of(
        cls, observation: Observation, space: Space, config: TabletopSamples, rng: np.random.Generator
    ) -> Scope:
        """The box around everything seen of objects, no deeper than the support plane."""
        seen = np.concatenate([item.points for item in observation.objects])
        low, high = seen.min(0) - config.radius, seen.max(0) + config.radius
        if observation.support is not None:
            low[2] = 0.0
        return cls(observation, space, config, rng, seen, low, high)

    @property
    def supported(self) -> bool:
        """Whether a support plane was found: z = 0 of the table frame, with nothing of an object below."""
        return self.observation.support is not None

    def cover(
        self, spacing: float, low: np.ndarray | None = None, high: np.ndarray | None = None
    ) -> np.ndarray:
        """Jittered samples (M, 3) of a box, the whole one by default, within `radius` of an object's box."""
        low, high = self.low if low is None else low, self.high if high is None else high
        points = jittered_lattice(low, high, spacing, self.rng)
        return points[self.observation.near_objects(points, self.config.radius)]

    def classify(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which points (N, 3) are known to be empty, and which are hidden: (N,) bool each."""
        region = self.space.classify(points)
        empty = (region == Region.FREE) | (region == Region.BELOW_SUPPORT)
        return empty, (region == Region.OCCLUDED) | (region == Region.OUT_OF_VIEW)
