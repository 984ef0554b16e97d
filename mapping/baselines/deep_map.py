"""ContraMap with hidden layers: a small network on the kernel features (paper, Section V-E).

With no hidden layer the loss is convex and is ContraMap's own; with one or two it is not, and Adam fits it on
random batches. The hinge points' features stay fixed: they are what makes the first layer sparse and fast.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from torch import nn
from typing_extensions import Self

from mapping.baselines.unfitted import SaysUnfitted
from mapping.config import FIT_CUTOFF
from mapping.errors import ConfigError, DataError
from mapping.kernels import PREDICT_CUTOFF
from mapping.lattice import LatticeEvaluator
from mapping.sparse_features import SparseFeatures, sparse_features
from mapping.sparse_rows import SparseRows


@dataclass(frozen=True)
class DeepMapConfig:
    """Network on the kernel features and how it is fitted."""

    gamma: float = 1000.0
    """Kernel width: phi = exp(-gamma d^2), in 1/m^2 for points in metres."""
    hidden_layers: int = 1
    """Hidden ReLU layers between the features and the softmax."""
    width: int = 32
    """Units of a hidden layer."""
    epochs: int = 4
    """Passes over the samples."""
    batch: int = 2048
    """Samples a step."""
    learning_rate: float = 0.02
    """Adam's step at the start; it falls linearly to 0."""


class DeepMap(SaysUnfitted):
    """Softmax network over kernel features; classes 0..C with the uncertain class last, as in ContraMap."""

    def __init__(self, config: DeepMapConfig | None = None) -> None:
        self.config = config or DeepMapConfig()
        if self.config.hidden_layers < 0 or self.config.gamma <= 0:
            raise ConfigError("hidden_layers must be >= 0 and gamma > 0")

    def fit(
        self,
        X: np.ndarray,
        y: np.ndarray,
        hinges: np.ndarray,
        rng: np.random.Generator,
        weights: np.ndarray | None = None,
    ) -> Self:
        """Minimise the weighted cross-entropy over points X (N, d) with classes y (N,).

        hinges: (H, d); weights: (N,) > 0. The rng draws the start and the order of the batches.
        """
        config = self.config
        if len(X) != len(y) or np.ndim(X) != 2 or np.shape(X)[1] != np.shape(hinges)[1]:
            raise DataError(f"X {np.shape(X)}, y {np.shape(y)} and hinges {np.shape(hinges)} do not fit")
        self.hinges = np.ascontiguousarray(hinges, np.float32)
        self._gamma = np.full(len(hinges), config.gamma, np.float32)
        features = self._features(X, FIT_CUTOFF)
        targets = torch.as_tensor(np.asarray(y, np.int64))[features.order]
        weights = np.ones(len(y)) if weights is None else weights
        importance = torch.as_tensor(np.asarray(weights, np.float32))[features.order]
        generator = torch.Generator().manual_seed(int(rng.integers(2**31)))
        self._build(int(targets.max()) + 1, generator)
        parameters = [self.first, self.bias, *self.rest.parameters()]
        optimiser = torch.optim.Adam(parameters, lr=config.learning_rate)
        steps = config.epochs * -(-len(targets) // config.batch)
        schedule = torch.optim.lr_scheduler.LinearLR(optimiser, 1.0, 0.0, steps)
        for _ in range(config.epochs):
            for rows in torch.randperm(len(targets), generator=generator).split(config.batch):
                optimiser.zero_grad()
                logits = self._tail(_rows_times(features.rows, rows, self.first))
                losses = nn.functional.cross_entropy(logits, targets[rows], reduction="none")
                (losses * importance[rows]).mean().backward()
                optimiser.step()
                schedule.step()
        return self

    @torch.no_grad()
    def predict_proba(self, X: np.ndarray) -> np.ndarray:
        """Class probabilities (N, C+1) at points X (N, d)."""
        features = self._features(X, PREDICT_CUTOFF)
        probabilities = torch.empty(len(X), self.class_count)
        probabilities[features.order] = torch.softmax(self._tail(features.times(self.first.detach())), dim=1)
        return probabilities.numpy()

    @torch.no_grad()
    def predict_lattice(self, axes: tuple[np.ndarray, ...]) -> np.ndarray:
        """Class probabilities (*lattice, C+1) on a regular lattice; same values as predict_proba."""
        first = LatticeEvaluator(self.hinges, self._gamma, self.first.detach(), self.bias.detach())
        return torch.softmax(self.rest(first(axes).movedim(0, -1)), dim=-1).numpy()

    def _build(self, classes: int, generator: torch.Generator) -> None:
        widths = [self.config.width] * self.config.hidden_layers + [classes]
        # A row of features has a norm near 1: unit weights give activations of unit size. Logits start at 0.
        scale = 1.0 if self.config.hidden_layers else 0.0
        self.class_count = classes
        self.first = nn.Parameter(scale * torch.randn(len(self.hinges), widths[0], generator=generator))
        self.bias = nn.Parameter(torch.zeros(widths[0]))
        self.rest = nn.Sequential()
        for inputs, outputs in pairwise(widths):
            layer = nn.Linear(inputs, outputs)
            with torch.no_grad():
                layer.weight.normal_(std=(2.0 / inputs) ** 0.5, generator=generator)
                layer.bias.zero_()
            self.rest.extend([nn.ReLU(), layer])

    def _tail(self, activations: torch.Tensor) -> torch.Tensor:
        return self.rest(activations + self.bias)

    def _features(self, X: np.ndarray, cutoff: float) -> SparseFeatures:
        points = np.ascontiguousarray(X, np.float32)
        return sparse_features(points, self.hinges, self._gamma, cutoff, torch.device("cpu"))


def _rows_times(matrix: SparseRows, rows: torch.Tensor, W: torch.Tensor) -> torch.Tensor:
    """The chosen rows of a sparse matrix times W, with gradients for W: (n,), (H, width) -> (n, width)."""
    ends = torch.cat([matrix.offsets[1:], torch.tensor([len(matrix.values)])])
    starts = matrix.offsets[rows].long()
    lengths = ends[rows].long() - starts
    offsets = lengths.cumsum(0) - lengths
    entries = torch.arange(int(lengths.sum())) + torch.repeat_interleave(starts - offsets, lengths)
    return nn.functional.embedding_bag(
        matrix.columns[entries].long(),
        W,
        offsets,
        mode="sum",
        per_sample_weights=matrix.values[entries],
    )
