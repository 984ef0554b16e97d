"""What every method of the evaluation is: a map fitted on one view, which answers in its table frame.

Knows observations and maps; knows nothing of truth or metrics. Class 0 is empty space, class k the k-th
observed object; probabilities are among these, whatever a method does with its uncertain class.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from perception.frame import Frame
from perception.observation import Observation
from perception.space import Space
from reconstruction.config import FusionConfig, MeshConfig
from reconstruction.fitted_scene import Surface, object_space
from reconstruction.surface.field import OUTSIDE, Field, window_of
from reconstruction.surface.meshing import extract_mesh


@dataclass(frozen=True)
class View:
    """What a method may know: one frame, and what perception makes of it."""

    frame: Frame
    observation: Observation
    space: Space


class FittedMap(ABC):
    """What a method learned from one view.

    samples: (N, 3) the observed points it learned from [m]; keeps_seen: whether its meshes keep every cell
    with a seen point (MeshConfig.keep_seen).
    """

    samples: np.ndarray
    keeps_seen = False

    @abstractmethod
    def predict(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Probabilities (N, K+1) of empty and the K objects, and uncertainty (N,), at points (N, 3)."""

    def occupancy(self, axes: list[np.ndarray], index: int) -> np.ndarray:
        """P(object `index`), 0-based, on the lattice spanned by three coordinate arrays: (nx, ny, nz).

        0 at nodes that are not worth asking.
        """
        wanted = self.worth_asking(axes)
        out = np.zeros(wanted.shape, np.float32)
        out[wanted] = self.predict(nodes(axes)[wanted.reshape(-1)])[0][:, index + 1]
        return out

    def meshes(self, view: View) -> list[Surface | None]:
        """The surface of each observed object, taken as the project takes its own from a lattice."""
        config = MeshConfig(fusion=FusionConfig(enabled=False))
        boxes = object_space(view.observation, config.margin, config.margin_share)
        field = self.field(*boxes, config.spacing)
        seen = [item.points if self.keeps_seen else None for item in view.observation.objects]
        extracted = (extract_mesh(field, index, config, points) for index, points in enumerate(seen))
        return [found and Surface(*found) for found in extracted]

    def field(self, lows: np.ndarray, highs: np.ndarray, spacing: float) -> Field:
        """Log odds and uncertainty on a lattice of `spacing` [m] over boxes lows..highs (K, 3)."""
        low, high = lows.min(0), highs.max(0)
        origin = np.floor(low / spacing) * spacing
        axes = [o + spacing * np.arange(int(np.ceil((h - o) / spacing)) + 2) for o, h in zip(origin, high)]
        everywhere = nodes(axes)
        wanted = self.worth_asking(axes).reshape(-1)
        probability, answered = self.predict(everywhere[wanted])
        shape = tuple(len(axis) for axis in axes)
        odds = np.full((probability.shape[1] - 1, len(everywhere)), OUTSIDE, np.float32)
        p = np.clip(probability[:, 1:].T, 1e-6, 1 - 1e-6)
        odds[:, wanted] = np.log(p / (1 - p))
        uncertainty = np.ones(len(everywhere), np.float32)
        uncertainty[wanted] = answered
        windows = [window_of(origin, spacing, shape, *box) for box in zip(lows, highs)]
        of_objects = [of_one.reshape(shape)[window] for of_one, window in zip(odds, windows)]
        return Field(origin, spacing, windows, of_objects, uncertainty.reshape(shape))

    def worth_asking(self, axes: list[np.ndarray]) -> np.ndarray:
        """Lattice nodes (nx, ny, nz) where an object can have P > 0.5, and those beside them."""
        return np.ones([len(axis) for axis in axes], bool)


Fit = Callable[[View, np.random.Generator], FittedMap]


@dataclass(frozen=True)
class MethodSpec:
    """A method by name. about: one line for people; seeded: whether its fit draws anything (if not, one fit
    serves all seeds, which only draw the points of the metrics)."""

    name: str
    fit: Fit
    about: str
    seeded: bool = True


def nodes(axes: list[np.ndarray]) -> np.ndarray:
    """The nodes (N, 3) float32 of the lattice spanned by three coordinate arrays, the last axis fastest."""
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3).astype(np.float32)


def beside(inside: np.ndarray) -> np.ndarray:
    """Nodes that are inside or neighbours of those: marching cubes looks no further."""
    return ndimage.binary_dilation(inside, np.ones((3, 3, 3), bool))
