"""Occupancy maps of the Radish logs: Hilbert map, Bayesian Hilbert map and ContraMap side by side."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from mapping.baselines.bayesian_hilbert import BayesianHilbertConfig, BayesianHilbertMap
from mapping.baselines.hilbert import HilbertMap
from mapping.contramap import ContraMap, MapConfig
from mapping.softmax import FitConfig
from perception.lidar import BeamConfig, LaserLog
from reconstruction.atomic import temporary_beside
from tools.evaluation.statistics import auroc
from tools.options import write_json
from tools.reproduce.landscape import (
    LANDSCAPES,
    OCCUPIED,
    UNCERTAIN,
    Landscape,
    Split,
    load_log,
    split_log,
)
from tools.reproduce.runs import Stopwatch, cached_run, check_choices, markdown_table, summarise

KEYS = ("auc", "train_s", "infer_s", "train_cpu_s", "infer_cpu_s")
"""Figures of a run. Processor seconds compare methods fairly on a machine that others use too."""

METHODS = ("hilbert", "bayesian_hilbert", "contramap")
"""Methods in the order in which they run and are listed."""

TITLES = {"hilbert": "Hilbert map", "bayesian_hilbert": "Bayesian Hilbert map", "contramap": "ContraMap"}

PAPER_AUC = {
    "belgioioso": (0.9904, 0.9901, 0.9901),
    "edmonton": (0.9754, 0.9734, 0.9767),
    "fhw": (0.9608, 0.9583, 0.9603),
    "intel": (0.9644, 0.9688, 0.9631),
    "mexico": (0.9726, 0.9709, 0.9731),
    "aces": (0.9075, 0.9121, 0.9116),
    "orebro": (0.9374, 0.9393, 0.9413),
    "seattle": (0.9621, 0.9684, 0.9622),
}
"""The paper's AUC of METHODS; the last three logs stand in its source only."""


@dataclass(frozen=True)
class OccupancyConfig:
    """Settings that every method shares, and those of the maps."""

    kernel_width: float = 6.71 * 0.5**2
    """gamma times the area of a hinge point's cell; gamma is 6.71 1/m^2 on Intel's 0.5 m grid."""
    l2: float = 1e-7
    """Weight of the squared norm of W beside the mean cross-entropy (Hilbert map and ContraMap)."""
    noise_weight: float = 0.1
    """Weight of a noise sample; 1 lets noise outvote the data where they are sparse."""
    fit: FitConfig = field(default_factory=FitConfig)
    """How the Hilbert map's and ContraMap's loss is minimised."""
    beams: BeamConfig = field(default_factory=BeamConfig)
    """How beams become labelled points."""
    held_out_run: int = 1
    """Consecutive scans held out together; 1 splits at random, 40 is the Hilbert maps reference."""
    query_per_hinge: int = 5
    """Map query points per hinge point along each axis; 5 is 0.1 m on Intel."""
    prior_precision: float = 1e-4
    """Prior precision of the Bayesian Hilbert map."""
    bayesian_iterations: int = 2
    """Rounds of posterior and xi a batch of the Bayesian Hilbert map."""

    def settings_of(self, method: str) -> dict[str, Any]:
        """The settings that the named method's result depends on."""
        bayesian = ("prior_precision", "bayesian_iterations")
        softmax = ("l2", "noise_weight", "fit")
        unused = softmax if method == "bayesian_hilbert" else bayesian
        return {key: value for key, value in asdict(self).items() if key not in unused}


class OccupancyMap(Protocol):
    """A fitted map, whatever its method."""

    def occupancy(self, X: np.ndarray) -> np.ndarray:
        """(N,) p_occupied / (p_occupied + p_free) at points X (N, 2)."""

    def draw(self, axes: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """(A, B, C) class probabilities on the map's lattice."""


class _SoftmaxOccupancy:
    def __init__(self, model: ContraMap) -> None:
        self.model = model

    def occupancy(self, X: np.ndarray) -> np.ndarray:
        return share_occupied(self.model.predict_proba(X))

    def draw(self, axes: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        return self.model.predict_lattice(axes)


class _BayesianOccupancy:
    def __init__(self, model: BayesianHilbertMap) -> None:
        self.model = model

    def occupancy(self, X: np.ndarray) -> np.ndarray:
        return self.model.predict_proba(X)[:, 1]

    def draw(self, axes: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        return self.model.predict_proba(lattice.reshape(-1, 2)).reshape(*lattice.shape[:2], 2)


def share_occupied(probabilities: np.ndarray) -> np.ndarray:
    """p_occupied / (p_occupied + p_free) of probabilities (..., 2 or 3)."""
    free, occupied = probabilities[..., 0].astype(np.float64), probabilities[..., 1].astype(np.float64)
    return occupied / np.maximum(free + occupied, 1e-30)


def fit_method(
    method: str,
    split: Split,
    landscape: Landscape,
    config: OccupancyConfig,
    rng: np.random.Generator,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> OccupancyMap:
    """Fit the named method to the split's training points."""
    gamma, hinges = landscape.gamma(config.kernel_width), landscape.hinges
    if method == "bayesian_hilbert":
        bayesian = BayesianHilbertConfig(
            gamma=gamma, prior_precision=config.prior_precision, iterations=config.bayesian_iterations
        )
        return _BayesianOccupancy(BayesianHilbertMap(bayesian).fit(split.X, split.y, hinges, rng, progress))
    map_config = MapConfig(gamma=gamma, l2=config.l2, fit=config.fit)
    if method == "hilbert":
        return _SoftmaxOccupancy(HilbertMap(map_config).fit(split.X, split.y, hinges=hinges))
    return _SoftmaxOccupancy(fit_contramap(split, hinges, map_config, config.noise_weight))


def fit_contramap(split: Split, hinges: np.ndarray, map_config: MapConfig, noise_weight: float) -> ContraMap:
    """ContraMap on the split's data and noise."""
    X, y, weights = with_noise(split, noise_weight)
    return ContraMap(map_config).fit(X, y, hinges=hinges, weights=weights)


def with_noise(split: Split, noise_weight: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Training points and noise (N + M, 2), their classes and their weights."""
    y = np.concatenate([split.y, np.full(len(split.noise), UNCERTAIN)])
    weights = np.where(y == UNCERTAIN, noise_weight, 1.0)
    return np.concatenate([split.X, split.noise]), y, weights


def measure(
    method: str,
    split: Split,
    landscape: Landscape,
    config: OccupancyConfig,
    rng: np.random.Generator,
    axes: tuple[np.ndarray, np.ndarray],
) -> tuple[dict[str, float], np.ndarray]:
    """AUC, training time and map drawing time [s] of one method; and its map (A, B, C) on the axes."""
    from tqdm import tqdm

    with tqdm(total=0, desc=f"{TITLES[method]}: batches", leave=False, disable=None) as bar:

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        train = Stopwatch()
        fitted = fit_method(method, split, landscape, config, rng, progress)
        figures = train.figures("train")
    infer = Stopwatch()
    drawn = fitted.draw(axes)
    figures |= infer.figures("infer")
    return {"auc": auroc(fitted.occupancy(split.X_test), split.y_test == OCCUPIED), **figures}, drawn


def run_occupancy(
    data: Path,
    out: Path,
    logs: tuple[str, ...] = tuple(LANDSCAPES),
    methods: tuple[str, ...] = METHODS,
    seeds: tuple[int, ...] = (0, 1, 2),
    config: OccupancyConfig | None = None,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Measure the methods on the logs; write runs, summary.json, table.md and figures under `out`.

    A (log, method, seed) that is already under out/runs with the same settings is not run again. Returns the
    summary. Raises ConfigError for unknown names, DataError for missing or broken logs.
    """
    from tqdm import tqdm

    config = config or OccupancyConfig()
    check_choices(logs, tuple(LANDSCAPES), "logs")
    check_choices(methods, METHODS, "methods")
    summary: dict[str, Any] = {"logs": {}, "corrupt_lines": {}, "seeds": list(seeds), "threads": _threads()}
    for name in tqdm(logs, desc="logs", disable=None):
        log = load_log(data, name)
        summary["corrupt_lines"][name] = log.corrupt_lines
        runs = _log_runs(log, name, out / "runs", methods, seeds, config, overwrite)
        summary["logs"][name] = {
            method: {**summarise(found, KEYS), "hinges": found[0]["hinges"]} for method, found in runs.items()
        }
        write_json(summary, out / "summary.json")
    (out / "table.md").write_text(occupancy_table(summary))
    from tools.reproduce.occupancy_figures import draw_maps

    for name in logs:
        draw_maps(out, name, LANDSCAPES[name], methods, seeds[0])
    return summary


def _log_runs(
    log: LaserLog,
    name: str,
    folder: Path,
    methods: tuple[str, ...],
    seeds: tuple[int, ...],
    config: OccupancyConfig,
    overwrite: bool,
) -> dict[str, list[dict[str, float]]]:
    """The results of every seed for each method on one log; maps are written beside the runs."""
    landscape = LANDSCAPES[name]

    @lru_cache(maxsize=1)
    def split_of(seed: int) -> Split:
        rng = np.random.default_rng(seed)
        return split_log(log, landscape, config.beams, config.held_out_run, rng)

    def run(method: str, seed: int) -> dict[str, float]:
        path = folder / f"{name}-{method}-{seed}.json"

        def compute() -> dict[str, Any]:
            split = split_of(seed)
            rng = np.random.default_rng([seed, 1])
            axes = landscape.query_axes(config.query_per_hinge)
            result, drawn = measure(method, split, landscape, config, rng, axes)
            path.parent.mkdir(parents=True, exist_ok=True)
            with temporary_beside(path.with_suffix(".npz")) as partial, partial.open("wb") as file:
                np.savez_compressed(file, probabilities=drawn.astype(np.float16))
            sizes = {"train_points": len(split.X), "test_points": len(split.X_test)}
            return {**result, **sizes, "hinges": len(landscape.hinges), "outside": split.outside}

        settings = {"log": name, "method": method, "seed": seed, **config.settings_of(method)}
        return cached_run(path, settings, compute, overwrite)

    runs: dict[str, list[dict[str, float]]] = {method: [] for method in methods}
    for seed in seeds:
        for method in methods:
            runs[method].append(run(method, seed))
    return runs


def occupancy_table(summary: dict[str, Any]) -> str:
    """The paper's table from a summary, with the paper's own AUC beside ours, in markdown.

    Times are processor seconds, wall-clock seconds in brackets; ratios are of processor seconds.
    """
    rows = []
    for name, methods in summary["logs"].items():
        bayesian = methods.get("bayesian_hilbert")
        for method, found in methods.items():
            auc = found["auc"]
            ratios = [
                f"{bayesian[key]['mean'] / found[key]['mean']:.0f}x"
                if bayesian and bayesian is not found
                else ""
                for key in ("train_cpu_s", "infer_cpu_s")
            ]
            rows.append(
                [
                    f"{name} (H = {found['hinges']})",
                    TITLES[method],
                    f"{auc['mean']:.4f} ± {auc['std']:.4f}",
                    f"{PAPER_AUC[name][METHODS.index(method)]:.4f}",
                    f"{found['train_cpu_s']['mean']:.2f} ({found['train_s']['mean']:.2f})",
                    ratios[0],
                    f"{found['infer_cpu_s']['mean']:.3f} ({found['infer_s']['mean']:.3f})",
                    ratios[1],
                ]
            )
    header = ["log", "method", "AUC", "paper's AUC", "training [s]", "faster", "map [s]", "faster"]
    return markdown_table(header, rows)


def _threads() -> int:
    import torch

    return torch.get_num_threads()
