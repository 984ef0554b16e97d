"""Batches of the occlusion prior's examples as tensors: made when asked for, or kept on a graphics card.

Knows examples and devices; knows nothing of losses and of what is learned.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from os import cpu_count
from typing import NamedTuple

import numpy as np
import torch
from torch.nn import functional as F

from reconstruction.prior.network import PriorNetwork
from tools.prior_data import Examples

AT_ONCE = 64
"""Examples that one thread turns into tensors at a time."""
Y_CHANNEL = 9
"""The channel that changes its sign when left and right are exchanged."""


class Batch(NamedTuple):
    """Of b objects with Q points each: lattices (b, C, *LATTICE), points in box coordinates (b, Q, 3), their
    channels (b, Q, P) and truth (b, Q), all float32 on one device."""

    lattices: torch.Tensor
    local: torch.Tensor
    channels: torch.Tensor
    truth: torch.Tensor

    def mirrored(self, chosen: torch.Tensor) -> Batch:
        """The same with left and right exchanged for the objects chosen (b,) bool."""
        sign = torch.where(chosen, -1.0, 1.0)
        lattices = torch.where(chosen[:, None, None, None, None], self.lattices.flip(3), self.lattices)
        local, channels = self.local.clone(), self.channels.clone()
        lattices[:, Y_CHANNEL] *= sign[:, None, None, None]
        local[..., 1] *= sign[:, None]
        channels[..., Y_CHANNEL] *= sign[:, None]
        return Batch(lattices, local, channels, self.truth)


class Batches:
    """Examples as batches on a device. On a graphics card all of them are kept there, in half precision: 0.45
    MB an object."""

    def __init__(self, examples: Examples, device: torch.device) -> None:
        self.examples, self.device = examples, device
        self._kept = None if device.type == "cpu" else _kept(examples, device)

    def __len__(self) -> int:
        return len(self.examples)

    def at(self, rows: np.ndarray) -> Batch:
        """The examples of rows (b,)."""
        if self._kept is None:
            return Batch(*map(torch.from_numpy, self.examples.inputs(rows)))
        chosen = torch.from_numpy(rows).to(self.device)
        return Batch(*(part[chosen].float() for part in self._kept))


def odds(network: PriorNetwork, batch: Batch) -> torch.Tensor:
    """Log odds (b, Q) that a network gives a batch, on the device of both."""
    features = network.encode(batch.lattices)
    if features.device.type == "cpu":
        return network.decode(features, batch.local, batch.channels)
    return network.decoder(torch.cat([sampled(features, batch.local), batch.channels], dim=-1))[..., 0]


def sampled(features: torch.Tensor, local: torch.Tensor) -> torch.Tensor:
    """Features (b, Q, F) at points (b, Q, 3) of lattices (b, F, X, Y, Z): what `PriorNetwork.decode` reads on
    a processor, for any device."""
    places = local.flip(-1)[:, :, None, None]  # grid_sample names the last axis first
    near = F.grid_sample(features, places, mode="bilinear", padding_mode="border", align_corners=False)
    return near[..., 0, 0].transpose(1, 2)


def _kept(examples: Examples, device: torch.device) -> list[torch.Tensor]:
    """All examples on a device: lattices, points, channels and truth."""
    count = len(examples)
    parts = [np.arange(first, min(first + AT_ONCE, count)) for first in range(0, count, AT_ONCE)]

    def made(rows: np.ndarray) -> list[torch.Tensor]:
        lattices, local, channels, truth = map(torch.from_numpy, examples.inputs(rows))
        return [part.to(device) for part in (lattices.half(), local, channels.half(), truth.half())]

    kept: list[torch.Tensor] = []
    with ThreadPoolExecutor(cpu_count()) as threads:
        for rows, columns in zip(parts, threads.map(made, parts)):
            if not kept:
                kept = [part.new_empty((count, *part.shape[1:])) for part in columns]
            for whole, part in zip(kept, columns):
                whole[rows[0] : rows[-1] + 1] = part
    return kept
