"""How the occlusion prior is trained: on a processor or a graphics card.

Knows examples and networks; knows nothing of how the examples were made and where weights go.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

import numpy as np
import torch
from torch.nn import functional as F

from reconstruction.prior.network import PriorNetwork
from sim_scenes.training.household import HOLLOW_MESH
from sim_scenes.training.shapes import HOLLOW_FAMILIES
from tools.prior_batches import Batches, odds
from tools.prior_data import Examples
from tools.prior_scores import score

HOLLOW = (*HOLLOW_FAMILIES, HOLLOW_MESH)
"""Kinds of objects that scenes for training have more of than tables do."""


FIT_FILE = "fit.pt"
"""The state of training within the folder of what is kept."""


class FitSettings(Protocol):
    """What training needs to be told."""

    @property
    def seed(self) -> int: ...
    @property
    def epochs(self) -> int: ...
    @property
    def batch(self) -> int: ...
    @property
    def rate(self) -> float: ...
    @property
    def decay(self) -> float: ...
    @property
    def solid(self) -> float: ...
    @property
    def device(self) -> str: ...
    @property
    def cache(self) -> Path | None: ...


def fit(network: PriorNetwork, examples: Examples, config: FitSettings, test: Examples) -> None:
    """Minimise the cross-entropy at the examples' points, on config.device.

    After each pass the state of training is kept in config.cache, where one is named, and taken from there.
    """
    from tqdm import tqdm

    device = torch.device(config.device)
    network.to(device)
    rng = np.random.default_rng(config.seed)
    weight = _weights(examples, config.solid).to(device)
    batches, tests = Batches(examples, device), Batches(test, device)
    steps = config.epochs * (len(examples) // config.batch)
    optimiser = torch.optim.AdamW(network.parameters(), lr=config.rate, weight_decay=config.decay)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, config.rate, total_steps=max(steps, 2), pct_start=0.05, cycle_momentum=False
    )
    kept = config.cache and config.cache / FIT_FILE
    done = 0
    if kept and kept.is_file():
        state = torch.load(kept, weights_only=True)
        done = state["epochs"]
        network.load_state_dict(state["network"])
        optimiser.load_state_dict(state["optimiser"])
        schedule.load_state_dict(state["schedule"])
        rng.bit_generator.state = state["rng"]
    network.train()
    per_epoch = len(examples) // config.batch
    progress = tqdm(total=steps, initial=done * per_epoch, desc="training", mininterval=5)
    for epoch in range(done, config.epochs):
        total = torch.zeros((), device=device)
        for rows in _batches(len(examples), config.batch, rng):
            # Half of the objects with left and right exchanged: nothing in the world tells them apart.
            chosen = torch.from_numpy(rng.random(len(rows)) < 0.5).to(device)
            batch = batches.at(rows).mirrored(chosen)
            loss = F.binary_cross_entropy_with_logits(
                odds(network, batch), batch.truth, weight=weight[rows, None]
            )
            optimiser.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimiser.step()
            schedule.step()
            progress.update()
            total += loss.detach()
        mean = float(total) / max(1, per_epoch)
        progress.write(f"epoch {epoch + 1}: loss {mean:.4f}, test {score(network, tests)['loss']:.4f}")
        network.train()
        if kept:
            state = {
                "epochs": epoch + 1,
                "network": network.state_dict(),
                "optimiser": optimiser.state_dict(),
                "schedule": schedule.state_dict(),
                "rng": rng.bit_generator.state,
            }
            temporary = kept.with_suffix(".tmp")
            torch.save(state, temporary)
            temporary.rename(kept)
    progress.close()
    network.to("cpu").eval()


def _weights(examples: Examples, solid: float) -> torch.Tensor:
    """Weight (B,) of each object in the loss, 1 on average."""
    weight = np.where(np.isin(examples.family, HOLLOW), 1.0, solid)
    return torch.from_numpy((weight / weight.mean()).astype(np.float32))


def _batches(count: int, size: int, rng: np.random.Generator) -> Iterator[np.ndarray]:
    order = rng.permutation(count)
    for start in range(0, count - size + 1, size):
        yield np.sort(order[start : start + size])
