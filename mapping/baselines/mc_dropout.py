"""MC dropout: dropout stays on at prediction, and the passes are averaged (Gal and Ghahramani 2016)."""

from __future__ import annotations

import numpy as np
import torch
from torch import nn
from typing_extensions import Self

from mapping.baselines.base import UncertaintyClassifier, check_labelled_points
from mapping.baselines.residual_network import (
    NetworkConfig,
    ResidualNetwork,
    as_tensor,
    seeded_torch,
    train,
)


class McDropout(UncertaintyClassifier):
    """One residual network, `passes` predictions with other units dropped in each."""

    def __init__(self, config: NetworkConfig | None = None, passes: int = 10) -> None:
        self.config, self.passes = config or NetworkConfig(), passes

    def fit(self, X: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> Self:
        X, y, classes = check_labelled_points(X, y)
        with seeded_torch(rng):
            self.network = ResidualNetwork(X.shape[1], nn.Linear(self.config.width, classes), self.config)
            train(self.network, X, y, self.config)
        self._prediction_seed = int(rng.integers(2**31))
        return self

    def predict_passes(self, X: np.ndarray) -> np.ndarray:
        """Class probabilities (passes, N, C) of each pass; the same units are dropped at every call."""
        points = as_tensor(X)
        self.network.train()  # keeps dropout on
        with torch.no_grad(), seeded_torch(np.random.default_rng(self._prediction_seed)):
            passes = [torch.softmax(self.network(points), dim=1) for _ in range(self.passes)]
        self.network.eval()
        return torch.stack(passes).double().numpy()

    def predict_proba(self, X: np.ndarray) -> np.ndarray:
        return self.predict_passes(X).mean(axis=0)
