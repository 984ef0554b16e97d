"""The semantic maps that are compared, behind one interface: kernel maps, and the nulls a k-d tree gives.

Knows labelled points; must not know scenes or protocols.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from scipy.spatial import cKDTree

from mapping.errors import ConfigError
from mapping.kernels import cell_numbers
from mapping.label_doubt import label_doubt
from mapping.multiscale import MultiscaleConfig, MultiscaleMap

TITLES = {
    "contramap": "ContraMap",
    "hilbert": "Hilbert map, same kernels",
    "nearest": "nearest labelled neighbour",
    "vote": "vote of 15 neighbours",
    "voxel": "voxel majority",
}
METHODS = tuple(TITLES)
NEIGHBOURS = 15
VOXEL = 0.2
"""Side of the voxels whose commonest label counts [m]."""


class Answers(NamedTuple):
    """Of N places: shares (N, C) of the classes; doubt (N,) that the likeliest one is right; unseen (N,), how
    much speaks for a place that was not observed. Of the last two only the order counts."""

    shares: np.ndarray
    doubt: np.ndarray
    unseen: np.ndarray


class SemanticMap(Protocol):
    """A fitted map, whatever its method."""

    def ask(self, X: np.ndarray) -> Answers:
        """At points (N, 3) [m]."""

    @property
    def size(self) -> int:
        """Numbers that the map keeps."""


class _Kernels:
    def __init__(self, model: MultiscaleMap) -> None:
        self.model = model

    def ask(self, X: np.ndarray) -> Answers:
        shares, uncertain = self.model.predict_known(X)
        return Answers(shares, label_doubt(shares), uncertain)

    @property
    def size(self) -> int:
        return self.model.size


class _Neighbours:
    """Shares of the labels among the nearest points; what is unseen is told by the distance of the nearest,
    and so is the doubt where one neighbour alone is asked."""

    def __init__(self, X: np.ndarray, y: np.ndarray, classes: int, count: int) -> None:
        self.tree, self.y, self.classes, self.count = cKDTree(X), y, classes, min(count, len(X))

    def ask(self, X: np.ndarray) -> Answers:
        distance, index = self.tree.query(X, np.arange(1, self.count + 1))
        shares = _shares(self.y[index], self.classes)
        return Answers(shares, distance[:, 0] if self.count == 1 else label_doubt(shares), distance[:, 0])

    @property
    def size(self) -> int:
        return 4 * len(self.y)


class _Voxels:
    """The labels' shares in the nearest voxel that holds points, and how far that is."""

    def __init__(self, X: np.ndarray, y: np.ndarray, classes: int) -> None:
        cell = np.floor(X / VOXEL)
        _, first, voxel = np.unique(cell_numbers(cell - cell.min(0)), return_index=True, return_inverse=True)
        self.tree = cKDTree((cell[first] + 0.5) * VOXEL)
        counts = np.bincount(voxel.reshape(-1) * classes + y, minlength=len(first) * classes)
        self.shares = counts.reshape(-1, classes) / counts.reshape(-1, classes).sum(1, keepdims=True)

    def ask(self, X: np.ndarray) -> Answers:
        distance, voxel = self.tree.query(X)
        shares = self.shares[voxel]
        return Answers(shares, label_doubt(shares), distance)

    @property
    def size(self) -> int:
        return self.shares.size + 3 * len(self.shares)


def fit_method(
    method: str,
    X: np.ndarray,
    y: np.ndarray,
    classes: int,
    config: MultiscaleConfig,
    rng: np.random.Generator,
) -> SemanticMap:
    """The named method of points X (N, 3) [m] with labels y (N,). Raises ConfigError for unknown names."""
    if method in ("contramap", "hilbert"):
        return _Kernels(MultiscaleMap(config, uncertain=method == "contramap").fit(X, y, classes, rng))
    if method == "nearest":
        return _Neighbours(X, y, classes, 1)
    if method == "vote":
        return _Neighbours(X, y, classes, NEIGHBOURS)
    if method == "voxel":
        return _Voxels(X, y, classes)
    raise ConfigError(f"method {method!r}: choose from {', '.join(METHODS)}")


def _shares(labels: np.ndarray, classes: int) -> np.ndarray:
    """Shares (N, C) of the labels (N, k)."""
    rows = np.repeat(np.arange(len(labels)), labels.shape[1])
    counts = np.bincount(rows * classes + labels.ravel(), minlength=len(labels) * classes)
    return counts.reshape(-1, classes) / labels.shape[1]
