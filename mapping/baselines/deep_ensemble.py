"""Deep ensemble: networks trained from different starts, averaged (Lakshminarayanan et al. 2017)."""

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


class DeepEnsemble(UncertaintyClassifier):
    """`members` residual networks that differ in their start and in the order of the data."""

    def __init__(self, config: NetworkConfig | None = None, members: int = 10) -> None:
        self.config, self.members = config or NetworkConfig(), members

    def fit(self, X: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> Self:
        X, y, classes = check_labelled_points(X, y)
        self.networks = []
        for _ in range(self.members):
            with seeded_torch(rng):
                network = ResidualNetwork(X.shape[1], nn.Linear(self.config.width, classes), self.config)
                train(network, X, y, self.config)
            self.networks.append(network)
        return self

    def predict_members(self, X: np.ndarray) -> np.ndarray:
        """Class probabilities (members, N, C) of each member."""
        points = as_tensor(X)
        with torch.no_grad():
            members = [torch.softmax(network(points), dim=1) for network in self.networks]
        return torch.stack(members).double().numpy()

    def predict_proba(self, X: np.ndarray) -> np.ndarray:
        return self.predict_members(X).mean(axis=0)
