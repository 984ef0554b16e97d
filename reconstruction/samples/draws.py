"""How samples are drawn: from a generator, or so that they stay where they are when a view is added.

Knows lattices and points; knows nothing of what samples are for. One view is drawn once; of several, the
samples of a place are to be those that it had before a view was added, for all that was asked about them is
known then.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mapping.samples import jittered, jittered_lattice, voxel_subsample
from mapping.steady_samples import steady_chance, steady_jitter, steady_lattice, steady_subsample
from perception.space import Space
from perception.views.joint_space import JointSpace


class Draws(Protocol):
    """Samples (M, 3) float32 [m] in the table frame."""

    def lattice(self, low: np.ndarray, high: np.ndarray, spacing: float) -> np.ndarray:
        """One in each cell of `spacing` that fills a box low..high (3,), or a little more."""

    def jitter(self, points: np.ndarray, spacing: float) -> np.ndarray:
        """Lattice points (N, 3), multiples of `spacing`, moved within their cells."""

    def subsample(self, points: np.ndarray, pixels: np.ndarray, size: float) -> np.ndarray:
        """Indices (M,) of one point (N, 3) a voxel; pixels: (N,) that see them."""

    def chance(self, points: np.ndarray, which: int) -> np.ndarray:
        """A number in [0, 1) for each point (N, 3), another for each `which`: (N,)."""


@dataclass(frozen=True)
class RandomDraws:
    """Drawn from a generator, which is used up by it."""

    rng: np.random.Generator

    def lattice(self, low: np.ndarray, high: np.ndarray, spacing: float) -> np.ndarray:
        return jittered_lattice(low, high, spacing, self.rng)

    def jitter(self, points: np.ndarray, spacing: float) -> np.ndarray:
        return jittered(points, spacing, self.rng)

    def subsample(self, points: np.ndarray, pixels: np.ndarray, size: float) -> np.ndarray:
        return voxel_subsample(points, size, self.rng)

    def chance(self, points: np.ndarray, which: int) -> np.ndarray:
        return self.rng.random(len(points))


@dataclass(frozen=True)
class SteadyDraws:
    """Drawn by place and seed. A voxel of a surface keeps the point of the first view that sees it."""

    seed: int
    space: JointSpace

    def lattice(self, low: np.ndarray, high: np.ndarray, spacing: float) -> np.ndarray:
        return steady_lattice(low, high, spacing, self.seed)

    def jitter(self, points: np.ndarray, spacing: float) -> np.ndarray:
        return steady_jitter(points, spacing, self.seed)

    def subsample(self, points: np.ndarray, pixels: np.ndarray, size: float) -> np.ndarray:
        return steady_subsample(points, self.space.stack.view_of(pixels), size, self.seed)

    def chance(self, points: np.ndarray, which: int) -> np.ndarray:
        return steady_chance(points, self.seed + 1 + which)


def draws_of(space: Space, rng: np.random.Generator) -> Draws:
    """How to draw the samples of a space."""
    if isinstance(space, JointSpace):
        return SteadyDraws(int(rng.integers(1 << 62)), space)
    return RandomDraws(rng)
