"""Built-in objects."""
from __future__ import annotations

import numpy as np
from sim_scenes.object_model import ObjectModel


def draw(count: int, rng: np.random.Generator) -> list[ObjectModel]:
    raise NotImplementedError
