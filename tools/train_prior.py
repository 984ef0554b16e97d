"""Trains the occlusion prior on procedural shapes: `python -m tools.train_prior --seed 0 --out FILE.npz`.

Makes scenes, trains, tests on shapes of held-out families, and writes the weights with a JSON file beside
them: command, data recipe, versions and held-out scores. No scan of a real object is used.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np
import torch
from torch.nn import functional as F

from reconstruction.prior.network import PriorNetwork
from reconstruction.prior.occlusion_prior import WEIGHTS_FILE, OcclusionPrior, save_weights
from sim_scenes.objects.random_urdfs import draw_figure, figures_folder
from sim_scenes.training.shapes import HELD_OUT_FAMILIES, TRAINING_FAMILIES, draw_shape
from tools.exit_code import exit_code
from tools.prior_data import Examples, make_examples

Y_CHANNEL = 9
"""The channel that changes its sign when left and right are exchanged."""


@dataclass(frozen=True)
class TrainConfig:
    """How the prior is trained. The defaults take about 40 minutes on two cores."""

    out: Path = WEIGHTS_FILE
    """Where the weights go; a .json with the recipe and scores is written beside them."""
    seed: int = 0
    """Same seed, same data and, on one machine and thread count, same weights."""
    scenes: int = 5400
    """Training scenes, of about five objects each."""
    test_scenes: int = 60
    """Scenes of held-out families, and as many of known families."""
    epochs: int = 5
    """Passes over the training objects."""
    batch: int = 16
    """Objects a step."""
    rate: float = 5e-3
    """Largest learning rate; it rises over the first twentieth of the steps and falls as a cosine."""
    decay: float = 1e-3
    """Weight decay."""
    workers: int = 2
    """Processes that make the scenes; the scenes are the same for any number."""
    cache: Path | None = None
    """Folder to keep the made examples in, and to take them from when they are there."""


def main() -> None:
    """Train with the options of the command line."""
    import tyro

    train(tyro.cli(TrainConfig, description=__doc__))


def train(config: TrainConfig) -> dict:
    """Make data, train, test, write. Returns what the JSON file holds."""
    start = perf_counter()
    known = partial(draw_shape, families=TRAINING_FAMILIES)
    strange = partial(draw_shape, families=HELD_OUT_FAMILIES)

    def examples(name: str, draw: Callable, count: int, seed: int) -> Examples:
        cache = config.cache and config.cache / f"{name}_{count}_{seed}.npz"
        return make_examples(count, draw, seed, f"{name} scenes", cache, config.workers)

    kept = config.cache and (config.cache / f"train_{config.scenes}_{config.seed}.npz").is_file()
    training = examples("train", known, config.scenes, config.seed)
    tests = {
        "known_families": examples("known", known, config.test_scenes, config.seed + 10_000),
        "held_out_families": examples("strange", strange, config.test_scenes, config.seed + 20_000),
    }
    if figures_folder() is not None:
        tests["random_urdfs"] = examples("figures", draw_figure, config.test_scenes, config.seed + 30_000)
    made = perf_counter()
    torch.manual_seed(config.seed)
    network = PriorNetwork(normalised=True)
    fit(network, training, config, tests["known_families"])
    save_weights(network.plain(), config.out)
    written = OcclusionPrior.load(config.out).network
    record = {
        "command": "python -m tools.train_prior " + _options(config),
        "config": {
            key: value for key, value in asdict(config).items() if key not in ("out", "cache", "workers")
        },
        "training_objects": len(training),
        "training_families": list(TRAINING_FAMILIES),
        "held_out_families": list(HELD_OUT_FAMILIES),
        "data": "procedural shapes (sim_scenes/training/shapes.py) in random scenes; no scans",
        "scores": {name: score(written, examples) for name, examples in tests.items()},
        "data_s": None if kept else round(made - start),
        "train_s": round(perf_counter() - made),
        "threads": torch.get_num_threads(),
        "torch": torch.__version__,
        "numpy": np.__version__,
    }
    temporary = config.out.with_suffix(".json.tmp")
    temporary.write_text(json.dumps(record, indent=1) + "\n")
    temporary.rename(config.out.with_suffix(".json"))
    print(json.dumps(record["scores"], indent=1))
    return record


def fit(network: PriorNetwork, examples: Examples, config: TrainConfig, test: Examples) -> None:
    """Minimise the cross-entropy at the examples' points."""
    from tqdm import tqdm

    rng = np.random.default_rng(config.seed)
    steps = config.epochs * (len(examples) // config.batch)
    optimiser = torch.optim.AdamW(network.parameters(), lr=config.rate, weight_decay=config.decay)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimiser, config.rate, total_steps=max(steps, 2), pct_start=0.05, cycle_momentum=False
    )
    network.train()
    progress = tqdm(total=steps, desc="training", mininterval=5)
    for epoch in range(config.epochs):
        total = 0.0
        for rows in _batches(len(examples), config.batch, rng):
            lattices, local, points, truth = _mirrored(*examples.inputs(rows), rng)
            odds = network.decode(network.encode(lattices), local, points)
            loss = F.binary_cross_entropy_with_logits(odds, truth)
            optimiser.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimiser.step()
            schedule.step()
            progress.update()
            total += loss.item()
        mean = total / max(1, len(examples) // config.batch)
        progress.write(f"epoch {epoch + 1}: loss {mean:.4f}, test {score(network, test)['loss']:.4f}")
        network.train()
    progress.close()
    network.eval()


def score(network: PriorNetwork, examples: Examples) -> dict:
    """Loss, IoU (mean over objects and by family), Brier score and calibration error at hidden points."""
    network.eval()
    odds = np.concatenate([_predict(network, examples, rows) for rows in _chunks(len(examples), 16)])
    probability, truth = 1 / (1 + np.exp(-odds)), examples.truth
    loss = np.logaddexp(0, odds) - truth * odds
    inside = probability > 0.5
    union = (inside | truth).sum(axis=1)
    iou = (inside & truth).sum(axis=1)[union > 0] / union[union > 0]
    families = examples.family[union > 0]
    return {
        "objects": len(examples),
        "loss": round(float(loss.mean()), 4),
        "iou": round(float(iou.mean()), 4),
        "brier": round(float(((probability - truth) ** 2).mean()), 4),
        "ece": round(calibration_error(probability.ravel(), truth.ravel()), 4),
        "iou_by_family": {
            str(name): round(float(iou[families == name].mean()), 3) for name in np.unique(families)
        },
    }


def calibration_error(probability: np.ndarray, truth: np.ndarray, bins: int = 15) -> float:
    """Mean gap between predicted and true share over bins of equal mass."""
    order = np.argsort(probability, kind="stable")
    groups = np.array_split(order, bins)
    gaps = [abs(probability[group].mean() - truth[group].mean()) * len(group) for group in groups]
    return float(np.sum(gaps) / len(order))


def _predict(network: PriorNetwork, examples: Examples, rows: np.ndarray) -> np.ndarray:
    lattices, local, points, _ = (torch.from_numpy(part) for part in examples.inputs(rows))
    with torch.inference_mode():
        return network.decode(network.encode(lattices), local, points).numpy()


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


def _options(config: TrainConfig) -> str:
    """The options that make the same weights again."""
    wanted = ("seed", "scenes", "test_scenes", "epochs", "batch", "rate", "decay")
    return " ".join(f"--{name.replace('_', '-')} {getattr(config, name):g}" for name in wanted)


def _batches(count: int, size: int, rng: np.random.Generator) -> Iterator[np.ndarray]:
    order = rng.permutation(count)
    for start in range(0, count - size + 1, size):
        yield np.sort(order[start : start + size])


def _chunks(count: int, size: int) -> Iterator[np.ndarray]:
    for start in range(0, count, size):
        yield np.arange(start, min(start + size, count))


if __name__ == "__main__":
    sys.exit(exit_code("train_prior", main))
