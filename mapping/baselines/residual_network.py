"""The residual network that the neural baselines share (the SNGP tutorial's), and its training loop."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn


@dataclass(frozen=True)
class NetworkConfig:
    """Network and training settings; the defaults are those of the SNGP tutorial's two moons."""

    width: int = 128
    """Units of every hidden layer."""
    layers: int = 6
    """Residual layers."""
    dropout: float = 0.1
    """Share of units dropped in each residual layer."""
    learning_rate: float = 1e-4
    """Adam's step."""
    batch: int = 128
    """Samples a step."""
    epochs: int = 100
    """Passes over the data."""


class ResidualNetwork(nn.Module):
    """A frozen linear input layer, residual layers h + dropout(relu(A h + b)), and a head."""

    def __init__(self, inputs: int, head: nn.Module, config: NetworkConfig) -> None:
        super().__init__()
        self.input = nn.Linear(inputs, config.width).requires_grad_(False)
        self.residual = nn.ModuleList(nn.Linear(config.width, config.width) for _ in range(config.layers))
        self.dropout = nn.Dropout(config.dropout)
        self.head = head
        for layer in [self.input, *self.residual]:  # Keras's defaults: the tutorial's length scales need them
            nn.init.xavier_uniform_(layer.weight)
            nn.init.zeros_(layer.bias)

    def hidden(self, X: torch.Tensor) -> torch.Tensor:
        """(N, width) activations that the head sees."""
        h = self.input(X)
        for layer in self.residual:
            h = h + self.dropout(torch.relu(layer(h)))
        return h

    def forward(self, X: torch.Tensor) -> torch.Tensor:
        return self.head(self.hidden(X))


def train(
    network: nn.Module,
    X: np.ndarray,
    y: np.ndarray,
    config: NetworkConfig,
    after_step: Callable[[], None] = lambda: None,
) -> None:
    """Minimise the softmax cross-entropy with Adam; `after_step` is called after each step."""
    points, labels = torch.as_tensor(X, dtype=torch.float32), torch.as_tensor(y)
    trained = [parameter for parameter in network.parameters() if parameter.requires_grad]
    optimiser = torch.optim.Adam(trained, lr=config.learning_rate)
    network.train()
    for _ in range(config.epochs):
        for chosen in torch.randperm(len(points)).split(config.batch):
            optimiser.zero_grad()
            nn.functional.cross_entropy(network(points[chosen]), labels[chosen]).backward()
            optimiser.step()
            after_step()
    network.eval()


@contextmanager
def seeded_torch(rng: np.random.Generator) -> Iterator[None]:
    """torch's global generator, seeded from rng inside the block and left as it was after it."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(rng.integers(2**31)))
        yield


def as_tensor(X: np.ndarray) -> torch.Tensor:
    """X (N, d) as a float32 tensor."""
    return torch.as_tensor(np.asarray(X), dtype=torch.float32)
