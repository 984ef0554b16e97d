"""Whether a view says anything of an object that is known already. Knows one observation and one object."""

from __future__ import annotations

import numpy as np

from perception.config import PerceptionConfig
from perception.observation import Observation
from perception.space import Region, Space

AROUND = 0.03
"""What a view sees through this near to an object matters to it [m]."""
STEP = 0.01
"""Places around an object that are asked are so far apart [m]."""


def touches(view: Observation, label: int, surface: np.ndarray, config: PerceptionConfig) -> bool:
    """Whether a view sees an object, or sees through or into the box around it.

    surface: (N, 3) points of what is known of the object [m, table frame].
    """
    if any(item.label == label for item in view.objects):
        return True
    low, high = surface.min(0) - AROUND, surface.max(0) + AROUND
    axes = [np.arange(a, b + STEP, STEP) for a, b in zip(low, high)]
    places = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3).astype(np.float32)
    region = Space.of(view, config).classify(places)
    return bool(np.isin(region, (Region.FREE, Region.SURFACE)).any())
