"""The paper's three toy sets in the plane: two classes, and a cluster that training never sees."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mapping.errors import ConfigError


@dataclass(frozen=True)
class ToyConfig:
    """Sizes of a toy set; the defaults are those of the SNGP tutorial."""

    points: int = 1000
    """Training points of both classes together; as many test points are drawn."""
    outliers: int = 500
    """Points of the unseen cluster."""
    noise: float = 0.1
    """Standard deviation around the moons and circles."""


@dataclass(frozen=True)
class ToySet:
    """One draw of a toy set. X: (N, 2) training points, y: (N,) their classes 0 and 1.

    X_test, y_test: a second draw of the same size. X_ood: (M, 2) the unseen cluster.
    low, high: (2,) corners of the square that is mapped; it holds all clusters.
    """

    name: str
    X: np.ndarray
    y: np.ndarray
    X_test: np.ndarray
    y_test: np.ndarray
    X_ood: np.ndarray
    low: np.ndarray
    high: np.ndarray


Sampler = Callable[[int, float, np.random.Generator], tuple[np.ndarray, np.ndarray]]


def two_ovals(count: int, noise: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Two parallel elongated Gaussians that a line separates; `noise` is not used.

    No generator of this set is published; these settings are ours: means (0, 0.75) and (0, -0.75), standard
    deviations 1.0 along x and 0.15 along y.
    """
    y = np.repeat([0, 1], [count - count // 2, count // 2])
    centre = np.where(y[:, None] == 0, [0.0, 0.75], [0.0, -0.75])
    return centre + rng.normal(size=(count, 2)) * [1.0, 0.15], y


def two_moons(count: int, noise: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Interleaved half circles, moved apart by (0.2, -0.4) as in the SNGP tutorial."""
    y = np.repeat([0, 1], [count - count // 2, count // 2])
    angle = np.concatenate([np.linspace(0.0, np.pi, n) for n in np.bincount(y)])
    upper = np.stack([np.cos(angle) - 0.1, np.sin(angle) + 0.2], axis=1)
    lower = np.stack([1.1 - np.cos(angle), 0.3 - np.sin(angle)], axis=1)
    return np.where(y[:, None] == 0, upper, lower) + rng.normal(scale=noise, size=(count, 2)), y


def two_circles(count: int, noise: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Rings of radius 1 and 0.8, moved side by side to (-1.2, -0.7) and (1.15, -0.7)."""
    y = np.repeat([0, 1], [count - count // 2, count // 2])
    angle = np.concatenate([np.linspace(0.0, 2.0 * np.pi, n, endpoint=False) for n in np.bincount(y)])
    ring = np.where(y == 0, 1.0, 0.8)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    centre = np.where(y[:, None] == 0, [-1.2, -0.7], [1.15, -0.7])
    return centre + ring + rng.normal(scale=noise, size=(count, 2)), y


OUTLIER_DEVIATION = 0.1
"""Standard deviation of the unseen clusters."""

_SETS: dict[str, tuple[Sampler, tuple[float, float]]] = {
    "two_ovals": (two_ovals, (2.4, 1.9)),
    "two_moons": (two_moons, (2.5, -1.75)),
    "two_circles": (two_circles, (-0.3, 1.36)),
}
"""Each set's generator and the centre of its unseen cluster."""

TOY_SETS = tuple(_SETS)
"""Names of the sets, in the paper's order."""


def make_toy_set(name: str, rng: np.random.Generator, config: ToyConfig | None = None) -> ToySet:
    """Draw the named set. Raises ConfigError for a name that is not in TOY_SETS."""
    if name not in _SETS:
        raise ConfigError(f"no toy set {name!r}; choose from {', '.join(TOY_SETS)}")
    config = config or ToyConfig()
    sampler, outlier_centre = _SETS[name]
    X, y = sampler(config.points, config.noise, rng)
    X_test, y_test = sampler(config.points, config.noise, rng)
    X_ood = outlier_centre + rng.normal(scale=OUTLIER_DEVIATION, size=(config.outliers, 2))
    return ToySet(name, X, y, X_test, y_test, X_ood, np.array([-3.5, -2.5]), np.array([3.5, 2.5]))
