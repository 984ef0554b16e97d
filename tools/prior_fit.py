"""The two ways the occlusion prior is trained: all of its network, or its decoder alone.

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
from tools.prior_data import Examples
from tools.prior_scores import chunks, score

HOLLOW = (*HOLLOW_FAMILIES, HOLLOW_MESH)
"""Kinds of objects that scenes for training have more of than tables do."""
Y_CHANNEL = 9
"""The channel that changes its sign when left and right are exchanged."""


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
    def cache(self) -> Path | None: ...


def fit(network: PriorNetwork, examples: Examples, config: FitSettings, test: Examples) -> None:
    """Minimise the cross-entropy at the examples' points.

    After each pass the state of training is kept in config.cache, where one is named, and taken from there.
    """
    from tqdm import tqdm

    rng = np.random.default_rng(config.seed)
    weight = _weights(examples, config.solid)
    steps = config.epochs * (len(examples) // config.batch)
    optimiser = torch.optim.AdamW(network.parameters(), lr=config.rate, weight_decay=config.decay)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, config.rate, total_steps=max(steps, 2), pct_start=0.05, cycle_momentum=False
    )
    kept = config.cache and config.cache / "fit.pt"
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
        total = 0.0
        for rows in _batches(len(examples), config.batch, rng):
            lattices, local, points, truth = _mirrored(*examples.inputs(rows), rng)
            odds = network.decode(network.encode(lattices), local, points)
            loss = F.binary_cross_entropy_with_logits(odds, truth, weight=weight[rows, None])
            optimiser.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimiser.step()
            schedule.step()
            progress.update()
            total += loss.item()
        mean = total / max(1, per_epoch)
        progress.write(f"epoch {epoch + 1}: loss {mean:.4f}, test {score(network, test)['loss']:.4f}")
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
    network.eval()


def fit_decoder(network: PriorNetwork, examples: Examples, config: FitSettings, test: Examples) -> None:
    """The same for the decoder alone: the encoder looks at every object once, and at its mirror image.

    A sixth of the time a pass; the encoder's features stay those that it was trained for.
    """
    from tqdm import tqdm

    rng = np.random.default_rng(config.seed)
    weight = _weights(examples, config.solid)
    plain = _features(network, examples, mirrored=False)
    mirror = _features(network, examples, mirrored=True)
    steps = config.epochs * (len(examples) // config.batch)
    optimiser = torch.optim.AdamW(network.decoder.parameters(), lr=config.rate, weight_decay=config.decay)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, config.rate, total_steps=max(steps, 2), pct_start=0.05, cycle_momentum=False
    )
    progress = tqdm(total=steps, desc="training the decoder", mininterval=5)
    for epoch in range(config.epochs):
        total = 0.0
        for rows in _batches(len(examples), config.batch, rng):
            local, points, truth = examples.points(rows)
            chosen = rng.random(len(rows)) < 0.5
            local[chosen, :, 1] *= -1
            points[chosen, :, Y_CHANNEL] *= -1
            seen = np.where(chosen[:, None, None, None, None], mirror[rows], plain[rows]).astype(np.float32)
            features, *rest = map(torch.from_numpy, (seen, local, points, truth))
            odds = network.decode(features, *rest[:2])
            loss = F.binary_cross_entropy_with_logits(odds, rest[2], weight=weight[rows, None])
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
            progress.update()
            total += loss.item()
        mean = total / max(1, len(examples) // config.batch)
        progress.write(f"epoch {epoch + 1}: loss {mean:.4f}, test {score(network, test)['loss']:.4f}")
    progress.close()
    network.eval()


def _weights(examples: Examples, solid: float) -> torch.Tensor:
    """Weight (B,) of each object in the loss, 1 on average."""
    weight = np.where(np.isin(examples.family, HOLLOW), 1.0, solid)
    return torch.from_numpy((weight / weight.mean()).astype(np.float32))


def _features(network: PriorNetwork, examples: Examples, mirrored: bool) -> np.ndarray:
    """What the encoder says of each object: (B, F, X, Y, Z) float16."""
    network.eval()
    found = []
    for rows in chunks(len(examples), 16):
        lattices = examples.lattices(rows)
        if mirrored:
            lattices = np.ascontiguousarray(lattices[:, :, :, ::-1])
            lattices[:, Y_CHANNEL] *= -1
        with torch.inference_mode():
            found.append(network.encode(torch.from_numpy(lattices)).numpy().astype(np.float16))
    return np.concatenate(found)


def _mirrored(
    lattices: np.ndarray, local: np.ndarray, points: np.ndarray, truth: np.ndarray, rng: np.random.Generator
) -> list[torch.Tensor]:
    """Half of the objects with left and right exchanged: nothing in the world tells them apart."""
    chosen = rng.random(len(lattices)) < 0.5
    lattices[chosen] = lattices[chosen][:, :, :, ::-1]
    lattices[chosen, Y_CHANNEL] *= -1
    local[chosen, :, 1] *= -1
    points[chosen, :, Y_CHANNEL] *= -1
    return [torch.from_numpy(part) for part in (lattices, local, points, truth)]


def _batches(count: int, size: int, rng: np.random.Generator) -> Iterator[np.ndarray]:
    order = rng.permutation(count)
    for start in range(0, count - size + 1, size):
        yield np.sort(order[start : start + size])
