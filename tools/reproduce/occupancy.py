"""Occupancy maps of the Radish logs: Hilbert map, Bayesian Hilbert map and ContraMap side by side."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from mapping.files import temporary_beside, write_atomically
from perception.lidar import LaserLog
from tools.evaluation.statistics import auroc
from tools.markdown import markdown_table
from tools.occupancy.fit import OCCUPIED
from tools.options import write_json
from tools.reproduce.landscape import LANDSCAPES, Landscape, Split, load_log, split_log
from tools.reproduce.occupancy_methods import METHODS, TITLES, OccupancyConfig, OccupancyMap, fit_method
from tools.reproduce.runs import check_choices, seconds, summarise, timed
from tools.runs.kept import cached_run

KEYS = ("auc", "train_s", "infer_s", "train_cpu_s", "infer_cpu_s")
"""Figures of a run. Processor seconds compare methods fairly on a machine that others use too."""

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
"""The paper's AUC of the first three of METHODS; the last three logs stand in its source only."""


def measure(
    method: str,
    split: Split,
    landscape: Landscape,
    config: OccupancyConfig,
    seed: int,
    axes: tuple[np.ndarray, np.ndarray],
) -> tuple[dict[str, float], np.ndarray]:
    """AUC, training time and map drawing time [s] of one method; and its map (A, B, C) on the axes."""
    from tqdm import tqdm

    with tqdm(total=0, desc=f"{TITLES[method]}: batches", leave=False, disable=None) as bar:

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        def fit() -> OccupancyMap:
            return fit_method(method, split, landscape, config, np.random.default_rng([seed, 1]), progress)

        fitted, training = timed("train", fit)
    drawn, drawing = timed("infer", lambda: fitted.draw(axes))
    auc = auroc(fitted.occupancy(split.X_test), split.y_test == OCCUPIED)
    return {"auc": auc, **training, **drawing}, drawn


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
    write_atomically(out / "table.md", occupancy_table(summary).encode())
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
            axes = landscape.query_axes(config.query_per_hinge)
            result, drawn = measure(method, split, landscape, config, seed, axes)
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

    Times are medians over the seeds: processor seconds, wall-clock seconds in brackets; ratios are of
    processor seconds.
    """
    rows = []
    for name, methods in summary["logs"].items():
        bayesian = methods.get("bayesian_hilbert")
        published = dict(zip(METHODS, PAPER_AUC[name]))
        for method, found in methods.items():
            auc = found["auc"]
            times = {key: found[key]["median"] for key in KEYS if key != "auc"}
            ratios = [
                f"{bayesian[key]['median'] / times[key]:.0f}x" if bayesian and bayesian is not found else ""
                for key in ("train_cpu_s", "infer_cpu_s")
            ]
            rows.append(
                [
                    f"{name} (H = {found['hinges']})",
                    TITLES[method],
                    f"{auc['mean']:.4f} ± {auc['std']:.4f}",
                    f"{published[method]:.4f}" if method in published else "",
                    f"{seconds(times['train_cpu_s'])} ({seconds(times['train_s'])})",
                    ratios[0],
                    f"{seconds(times['infer_cpu_s'])} ({seconds(times['infer_s'])})",
                    ratios[1],
                ]
            )
    header = ["log", "method", "AUC", "paper's AUC", "training [s]", "faster", "map [s]", "faster"]
    return markdown_table([header, *rows])


def _threads() -> int:
    import torch

    return torch.get_num_threads()
