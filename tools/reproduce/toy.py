"""Uncertainty on the paper's toy sets: every method against the Gaussian process, drawn and measured."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mapping.baselines.base import gini
from mapping.files import temporary_beside, write_atomically
from sim_scenes.toy2d import TOY_SETS, ToySet, make_toy_set
from tools.evaluation.statistics import auroc, spearman
from tools.markdown import markdown_table
from tools.options import write_json
from tools.reproduce.runs import check_choices, summarise
from tools.reproduce.toy_methods import METHODS, TITLES, ToyStudyConfig, make_method
from tools.runs.kept import cached_run
from tools.stopwatch import Stopwatch

KEYS = (
    "spearman_gp",
    "spearman_gp_predictive",
    "spearman_distance",
    "ood_auroc",
    "accuracy",
    "fit_cpu_s",
    "predict_cpu_s",
    "fit_s",
    "predict_s",
)
"""Figures of each method. spearman_gp: rank correlation with the Gaussian process's posterior variance over
the grid; spearman_gp_predictive: with its p (1 - p); spearman_distance: with the expected distance d(x)."""


def grid_axes(toy: ToySet, count: int) -> tuple[np.ndarray, np.ndarray]:
    """x and y coordinates of the query grid."""
    return np.linspace(toy.low[0], toy.high[0], count), np.linspace(toy.low[1], toy.high[1], count)


def grid_points(toy: ToySet, count: int) -> np.ndarray:
    """(count^2, 2) points of the query grid, y fastest."""
    return np.stack(np.meshgrid(*grid_axes(toy, count), indexing="ij"), axis=-1).reshape(-1, 2)


def expected_distance(X: np.ndarray, data: np.ndarray, rows: int = 1000) -> np.ndarray:
    """(N,) mean distance of points X (N, 2) to the data (M, 2): d(x) of the paper's Section IV."""
    chunks = [X[start : start + rows] for start in range(0, len(X), rows)]
    return np.concatenate([np.linalg.norm(c[:, None] - data, axis=2).mean(axis=1) for c in chunks])


def run_toy(
    out: Path,
    sets: tuple[str, ...] = TOY_SETS,
    methods: tuple[str, ...] = METHODS,
    seeds: tuple[int, ...] = (0, 1, 2, 3, 4),
    config: ToyStudyConfig | None = None,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Fit the methods on the sets; write runs, summary.json, table.md and uncertainty.png under `out`.

    A (set, method, seed) that is already under out/runs with the same settings is not run again. Returns the
    summary. Raises ConfigError for unknown names.
    """
    from tqdm import tqdm

    from tools.reproduce.toy_figure import draw_toy

    config = config or ToyStudyConfig()
    check_choices(sets, TOY_SETS, "sets")
    check_choices(methods, METHODS, "methods")
    methods = tuple(method for method in METHODS if method in (*methods, "gp"))
    found: dict[tuple[str, str], list[dict[str, float]]] = {}
    print(
        f"fitting {len(methods)} methods to {len(sets)} sets with {len(seeds)} seeds each; what is under "
        f"{out / 'runs'} with the same settings is not fitted again",
        flush=True,
    )
    with tqdm(total=len(sets) * len(seeds) * len(methods), desc="toy runs", disable=None) as bar:
        for name in sets:
            for seed in seeds:
                for method, result in _seed_results(
                    out / "runs", name, methods, seed, config, overwrite, bar
                ):
                    found.setdefault((name, method), []).append(result)
            tqdm.write(f"{name}: {len(methods)} methods, {len(seeds)} seeds done")
    summary = {
        "seeds": list(seeds),
        "sets": {name: {method: summarise(found[name, method], KEYS) for method in methods} for name in sets},
    }
    write_json(summary, out / "summary.json")
    write_atomically(out / "table.md", toy_table(summary).encode())
    toys = {name: make_toy_set(name, np.random.default_rng(seeds[0]), config.data) for name in sets}
    fields = {(s, m): _load_field(out / "runs", s, m, seeds[0])["uncertainty"] for s in sets for m in methods}
    draw_toy(out / "uncertainty.png", toys, methods, fields, config.grid)
    return summary


def toy_table(summary: dict[str, Any]) -> str:
    """The summary's means and spreads in markdown; the best of the methods beside the reference is bold."""
    rows = []
    for name, methods in summary["sets"].items():
        best = max(
            (m for m in methods if m != "gp"), key=lambda m: methods[m]["spearman_gp"]["mean"], default=""
        )
        for method, figures in methods.items():
            cells = [f"{figures[k]['mean']:.3f} ± {figures[k]['std']:.3f}" for k in KEYS[:4]]
            if method == best:
                cells[0] = f"**{cells[0]}**"
            cells += [f"{figures[k]['mean']:.3f}" for k in KEYS[4:7]]
            rows.append([name.replace("_", " "), TITLES[method], *cells])
    header = [
        "set",
        "method",
        "Spearman with GP variance",
        "Spearman with GP p(1-p)",
        "Spearman with d(x)",
        "OOD AUROC",
        "accuracy",
        "fit [processor s]",
        "predict [processor s]",
    ]
    return markdown_table([header, *rows])


def _seed_results(
    folder: Path,
    name: str,
    methods: tuple[str, ...],
    seed: int,
    config: ToyStudyConfig,
    overwrite: bool,
    bar: Any,
) -> list[tuple[str, dict[str, float]]]:
    """Figures of every method on one draw of one set; the reference comes first."""
    toy = make_toy_set(name, np.random.default_rng(seed), config.data)
    distance = expected_distance(grid_points(toy, config.grid), toy.X)
    results = []
    for method in methods:
        bar.set_postfix_str(f"{name}, seed {seed}, {TITLES[method]}")
        path = folder / f"{name}-{method}-{seed}.json"
        settings = {"set": name, "method": method, "seed": seed, **config.settings_of(method)}
        compute = partial(_run, path, method, toy, seed, config)
        result = cached_run(path, settings, compute, overwrite)
        field_, reference = (_load_field(folder, name, m, seed) for m in (method, "gp"))
        ranks = {
            "spearman_gp": spearman(field_["uncertainty"], reference["uncertainty"]),
            "spearman_gp_predictive": spearman(field_["uncertainty"], reference["predictive"]),
            "spearman_distance": spearman(field_["uncertainty"], distance),
        }
        results.append((method, {**result, **ranks}))
        bar.update()
    return results


def _run(path: Path, method: str, toy: ToySet, seed: int, config: ToyStudyConfig) -> dict[str, float]:
    """Fit one method; its uncertainty over the grid goes beside the run."""
    model = make_method(method, toy, config)
    fit = Stopwatch()
    model.fit(toy.X, toy.y, np.random.default_rng([seed, 1]))
    times = fit.figures("fit")
    points = grid_points(toy, config.grid)
    predict = Stopwatch()
    uncertainty = model.uncertainty(points)
    times |= predict.figures("predict")
    known, unseen = model.uncertainty(toy.X_test), model.uncertainty(toy.X_ood)
    is_ood = np.concatenate([np.zeros(len(known)), np.ones(len(unseen))])
    accuracy = (model.predict_proba(toy.X_test).argmax(axis=1) == toy.y_test).mean()
    path.parent.mkdir(parents=True, exist_ok=True)
    with temporary_beside(path.with_suffix(".npz")) as unfinished, unfinished.open("wb") as file:
        np.savez_compressed(file, uncertainty=uncertainty, predictive=gini(model.predict_proba(points)))
    return {
        "ood_auroc": auroc(np.concatenate([known, unseen]), is_ood),
        "accuracy": float(accuracy),
        **times,
    }


def _load_field(folder: Path, name: str, method: str, seed: int) -> dict[str, np.ndarray]:
    with np.load(folder / f"{name}-{method}-{seed}.npz") as stored:
        return dict(stored)
