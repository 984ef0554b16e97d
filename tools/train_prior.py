"""Trains the occlusion prior: `python -m tools.train_prior --seed 0 --household DIR --out FILE.npz`.

Makes scenes of procedural shapes and, where a folder is named, of household meshes of its part `train`;
trains, tests on held-out shapes and objects, and writes the weights with a JSON file beside them: command,
data, its licences, versions and held-out scores. YCB scans are never used.

The project's own weights are from `--seed 1 --scenes 11800 --epochs 20 --batch 64 --solid 1.6 --household DIR
--device cuda --out FIRST` (11 s a pass on an H200), then `--seed 2 --scenes 4000 --epochs 1 --batch 32 --rate
0.001 --solid 1.6 --household DIR --start FIRST --keep 0.5`.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from copy import deepcopy
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Literal

import numpy as np
import torch

from mapping.errors import ConfigError, DataError
from reconstruction.prior.network import PriorNetwork
from reconstruction.prior.occlusion_prior import WEIGHTS_FILE, OcclusionPrior, save_weights
from sim_scenes.objects.random_urdfs import draw_figure, figures_folder
from sim_scenes.training.household import Household, Meshes, held_out_kinds, sources, training_names
from sim_scenes.training.shapes import HELD_OUT_FAMILIES, TRAINING_FAMILIES, draw_shape
from tools.exit_code import exit_code
from tools.prior_batches import Batches
from tools.prior_data import Examples, make_examples
from tools.prior_fit import FIT_FILE, fit
from tools.prior_scores import score

PLACES = ("out", "cache", "workers", "household", "start")
"""Settings that say where things are, not how the weights come about."""
ATTRIBUTION = (
    "Google Scanned Objects (Downs et al., 2022), Google Research, CC BY 4.0, "
    "https://creativecommons.org/licenses/by/4.0/; simplified and closed for training"
)


@dataclass(frozen=True)
class TrainConfig:
    """How the prior is trained. The defaults take about an hour on two cores."""

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
    household: Path | None = None
    """Folder of household meshes to learn from as well, those of its part `train`; none by default."""
    share: float = 0.6
    """Share of the shapes that are household meshes, where their folder is named."""
    solid: float = 1.0
    """How much solid objects count in the loss beside hollow ones, of which scenes have more than tables."""
    start: Path | None = None
    """Weights to go on from; random by default."""
    keep: float = 0.0
    """Share of the weights gone on from in the result. Half and half answers better than either, on objects
    of kinds that were learned from and of others (Wortsman et al. 2022)."""
    device: Literal["cpu", "cuda"] = "cpu"
    """Where the network is trained; a graphics card needs 0.45 MB an object and repeats itself roughly."""
    cache: Path | None = None
    """Folder to keep made examples and the state of training in: a run that was stopped goes on from there,
    with the same result. An empty one for another recipe."""


def main() -> None:
    """Train with the options of the command line."""
    import tyro

    train(tyro.cli(TrainConfig, description=__doc__))


def train(config: TrainConfig) -> dict:
    """Make data, train, test, write. Returns what the JSON file holds."""
    if not 0 <= config.keep <= 1 or (config.keep and config.start is None):
        raise ConfigError(f"--keep is a share of the weights of --start, from 0 to 1, got {config.keep}")
    if config.device == "cuda" and not torch.cuda.is_available():
        raise ConfigError("--device cuda: torch finds no graphics card here; use --device cpu")
    start = perf_counter()
    torch.manual_seed(config.seed)
    # Weights that are used have no normalisation layers: training goes on from them without.
    begun = PriorNetwork(normalised=True) if config.start is None else started_from(config.start)
    earlier = None if config.start is None else _record_of(config.start)
    known: Callable = partial(draw_shape, families=TRAINING_FAMILIES)
    learned_from = known
    if config.household is not None:
        names = training_names(config.household)
        learned_from = Household(config.household, names, config.share)
    strange = partial(draw_shape, families=HELD_OUT_FAMILIES)

    def examples(name: str, draw: Callable, count: int, seed: int) -> Examples:
        cache = config.cache and config.cache / f"{name}_{seed}"
        return make_examples(count, draw, seed, f"{name} scenes", cache, config.workers)

    kept = config.cache and (config.cache / f"train_{config.seed}").is_dir()
    training = examples("train", learned_from, config.scenes, config.seed)
    tests = {
        "known_families": examples("known", known, config.test_scenes, config.seed + 10_000),
        "held_out_families": examples("strange", strange, config.test_scenes, config.seed + 20_000),
    }
    if figures_folder() is not None:
        tests["random_urdfs"] = examples("figures", draw_figure, config.test_scenes, config.seed + 30_000)
    if config.household is not None:
        judged = Meshes(config.household, held_out_kinds(config.household))
        tests["held_out_meshes"] = examples("meshes", judged, 2 * config.test_scenes, config.seed + 40_000)
    made = perf_counter()
    resumed = config.cache and (config.cache / FIT_FILE).is_file()
    fit(begun, training, config, tests["known_families"])
    trained = perf_counter()
    network = begun.plain() if config.start is None else mixed(begun, started_from(config.start), config.keep)
    save_weights(network, config.out)
    written, on_cpu = OcclusionPrior.load(config.out).network, torch.device("cpu")
    record = {
        "command": "python -m tools.train_prior " + _options(config),
        "config": {key: value for key, value in asdict(config).items() if key not in PLACES},
        "start": earlier,
        "training_objects": len(training),
        "training_families": list(TRAINING_FAMILIES),
        "held_out_families": list(HELD_OUT_FAMILIES),
        "data": "procedural shapes (sim_scenes/training/shapes.py)"
        + (" and household meshes" if config.household else "")
        + " in random scenes; no YCB scans",
        "household": None if config.household is None else _household_record(config.household),
        "scores": {name: score(written, Batches(judged, on_cpu)) for name, judged in tests.items()},
        "data_s": None if kept else round(made - start),
        "train_s": None if resumed else round(trained - made),
        "trained_on": torch.cuda.get_device_name() if config.device == "cuda" else "processor",
        "threads": torch.get_num_threads(),
        "torch": torch.__version__,
        "numpy": np.__version__,
    }
    temporary = config.out.with_suffix(".json.tmp")
    temporary.write_text(json.dumps(record, indent=1) + "\n")
    temporary.rename(config.out.with_suffix(".json"))
    print(json.dumps(record["scores"], indent=1))
    return record


def started_from(path: Path) -> PriorNetwork:
    """A network of its own with the weights of a file."""
    return deepcopy(OcclusionPrior.load(path).network)


def mixed(network: PriorNetwork, other: PriorNetwork, share: float) -> PriorNetwork:
    """The network with a share of another's weights in its own."""
    with torch.no_grad():
        for value, theirs in zip(network.parameters(), other.parameters()):
            value.lerp_(theirs, share)
    return network


def _record_of(weights: Path) -> dict:
    """How the weights that training goes on from were made."""
    path = weights.with_suffix(".json")
    if not path.is_file():
        raise DataError(f"{path}: the record beside the weights is missing; --start needs it")
    record = json.loads(path.read_text())
    wanted = ("command", "data", "start", "household", "training_objects", "trained_on", "torch", "numpy")
    return {name: record[name] for name in wanted if name in record}


def _household_record(folder: Path) -> dict:
    """Whose meshes were learned from, by folder of the source, under which licences."""
    listed = sources(folder)
    names = [name for name in training_names(folder) if name in listed]
    licences: dict[str, int] = {}
    for name in names:
        label = f"{listed[name]['file'].split('/')[0]}: {listed[name]['licence']}"
        licences[label] = licences.get(label, 0) + 1
    return {
        "meshes": len(training_names(folder)),
        "objects_by_source_and_licence": licences,
        "attribution": ATTRIBUTION,
        "held_out": "objects that sim_scenes.objects.split.held_out names",
    }


def _options(config: TrainConfig) -> str:
    """The options that make the same weights again."""
    wanted = ("seed", "scenes", "test_scenes", "epochs", "batch", "rate", "decay", "solid")
    given = " ".join(f"--{name.replace('_', '-')} {getattr(config, name):g}" for name in wanted)
    if config.household is not None:
        given += f" --household DIR --share {config.share:g}"
    if config.start is not None:
        given += f" --start FILE --keep {config.keep:g}"
    return given if config.device == "cpu" else f"{given} --device {config.device}"


if __name__ == "__main__":
    sys.exit(exit_code("train_prior", main))
