"""Accuracy and time against the number of hinge points: ContraMap, with hidden layers too, and its rival."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from mapping.baselines.deep_map import DeepMap, DeepMapConfig
from mapping.files import write_atomically
from tools.evaluation.statistics import auroc
from tools.markdown import markdown_table
from tools.occupancy.fit import OCCUPIED, share_occupied
from tools.options import write_json
from tools.reproduce.landscape import LANDSCAPES, Landscape, Split, load_log, split_log
from tools.reproduce.occupancy import KEYS, measure
from tools.reproduce.occupancy_methods import OccupancyConfig, with_noise
from tools.reproduce.runs import (
    check_choices,
    save_figure,
    seconds,
    summarise,
    timed,
)
from tools.runs.kept import cached_run
from tools.stopwatch import Stopwatch

TITLES = {
    "contramap_0": "ContraMap, no hidden layer",
    "contramap_1": "ContraMap, 1 hidden layer",
    "contramap_2": "ContraMap, 2 hidden layers",
    "bayesian_hilbert": "Bayesian Hilbert map",
}
METHODS = tuple(TITLES)


@dataclass(frozen=True)
class HingesConfig:
    """Settings of the hinge-point study."""

    occupancy: OccupancyConfig = field(default_factory=OccupancyConfig)
    """Data, map and Bayesian settings; gamma grows with the hinge points' density."""
    network: DeepMapConfig = field(default_factory=DeepMapConfig)
    """Network of the maps with hidden layers; its gamma and hidden_layers are set by the study."""
    query_step: float = 0.1
    """Spacing of the map's query points [m], the same for every number of hinge points."""


def run_hinges(
    data: Path,
    out: Path,
    log: str = "intel",
    counts: tuple[int, ...] = (350, 700, 1400, 2800, 5600),
    methods: tuple[str, ...] = METHODS,
    seeds: tuple[int, ...] = (0, 1, 2),
    config: HingesConfig | None = None,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Measure the methods for each number of hinge points; write runs, summary.json, table.md, hinges.png.

    A (count, method, seed) that is already under out/runs with the same settings is not run again. Returns
    the summary. Raises ConfigError for unknown names, DataError for a missing or broken log.
    """
    from tqdm import tqdm

    config = config or HingesConfig()
    check_choices((log,), tuple(LANDSCAPES), "log")
    check_choices(methods, METHODS, "methods")
    laser = load_log(data, log)
    whole = LANDSCAPES[log]

    @lru_cache(maxsize=1)
    def split_of(seed: int) -> Split:
        rng = np.random.default_rng(seed)
        return split_log(laser, whole, config.occupancy.beams, config.occupancy.held_out_run, rng)

    def run(method: str, count: int, seed: int) -> dict[str, float]:
        landscape = whole.with_hinges(count)
        settings = {"log": log, "method": method, "hinges": count, "seed": seed, **_settings(method, config)}
        path = out / "runs" / f"{log}-{method}-{count}-{seed}.json"
        return cached_run(
            path,
            settings,
            lambda: {**_measure(method, split_of(seed), landscape, config, seed), "hinges": count},
            overwrite,
        )

    todo = [(method, count, seed) for seed in seeds for method in methods for count in counts]
    found: dict[tuple[str, int], list[dict[str, float]]] = {}
    for method, count, seed in tqdm(todo, desc="hinge runs", disable=None):
        found.setdefault((method, count), []).append(run(method, count, seed))
    summary = {
        "log": log,
        "seeds": list(seeds),
        "methods": {
            method: {str(count): summarise(found[method, count], KEYS) for count in counts}
            for method in methods
        },
    }
    write_json(summary, out / "summary.json")
    write_atomically(out / "table.md", hinges_table(summary).encode())
    _draw(out / "hinges.png", summary)
    return summary


def hinges_table(summary: dict[str, Any]) -> str:
    """The summary in markdown, one line a method and number of hinge points."""
    rows = [
        [
            TITLES[method],
            count,
            f"{figures['auc']['mean']:.4f} ± {figures['auc']['std']:.4f}",
            seconds(figures["train_cpu_s"]["median"]),
            seconds(figures["infer_cpu_s"]["median"]),
        ]
        for method, counts in summary["methods"].items()
        for count, figures in counts.items()
    ]
    return markdown_table([["method", "hinge points", "AUC", "training [s]", "map [s]"], *rows])


def _settings(method: str, config: HingesConfig) -> dict[str, Any]:
    """The settings that the named method's result depends on."""
    used = config.occupancy.settings_of("bayesian_hilbert" if method == "bayesian_hilbert" else "contramap")
    network = asdict(config.network) if method in ("contramap_1", "contramap_2") else None
    return {**used, "network": network, "query_step": config.query_step}


def _measure(
    method: str, split: Split, landscape: Landscape, config: HingesConfig, seed: int
) -> dict[str, float]:
    axes = query_axes(landscape, config.query_step)
    if method in ("contramap_0", "bayesian_hilbert"):
        name = "contramap" if method == "contramap_0" else method
        return measure(name, split, landscape, config.occupancy, seed, axes)[0]
    network = asdict(config.network) | {
        "hidden_layers": int(method[-1]),
        "gamma": landscape.gamma(config.occupancy.kernel_width),
    }
    X, y, weights = with_noise(split, config.occupancy.noise_weight)
    rng = np.random.default_rng([seed, 1])
    train = Stopwatch()
    model = DeepMap(DeepMapConfig(**network)).fit(X, y, landscape.hinges, rng, weights)
    figures = train.figures("train")
    figures |= timed("infer", lambda: model.predict_lattice(axes))[1]
    auc = auroc(share_occupied(model.predict_proba(split.X_test)), split.y_test == OCCUPIED)
    return {"auc": auc, **figures}


def query_axes(landscape: Landscape, step: float) -> tuple[np.ndarray, np.ndarray]:
    """x and y coordinates [m] of query points `step` apart."""
    x, y = (np.arange(low + step / 2, high, step) for low, high in zip(landscape.low, landscape.high))
    return x, y


def _draw(path: Path, summary: dict[str, Any]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(12, 3.4), layout="constrained")
    panels = {"auc": "AUC", "train_cpu_s": "training [processor s]", "infer_cpu_s": "drawing [processor s]"}
    for axis, (key, label) in zip(axes, panels.items()):
        for method, counts in summary["methods"].items():
            numbers = [int(count) for count in counts]
            values = [figures[key]["mean" if key == "auc" else "median"] for figures in counts.values()]
            axis.plot(numbers, values, "o-", markersize=4, label=TITLES[method])
        axis.set(
            xscale="log", xlabel="hinge points", ylabel=label, yscale="linear" if key == "auc" else "log"
        )
        axis.set_xticks(numbers, labels=map(str, numbers))
        axis.xaxis.minorticks_off()
        axis.grid(alpha=0.3, which="both")
    axes[0].legend(fontsize=8)
    save_figure(figure, path)
    plt.close(figure)
