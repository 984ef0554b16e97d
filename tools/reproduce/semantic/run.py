"""Semantic maps measured: ContraMap, Hilbert map and nulls on labelled scenes, under every protocol."""

from __future__ import annotations

import resource
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from mapping.files import write_atomically
from mapping.multiscale import MultiscaleConfig
from tools.evaluation.statistics import auroc, brier
from tools.markdown import markdown_table
from tools.options import write_json
from tools.reproduce.runs import check_choices, seconds, summarise, timed
from tools.reproduce.semantic.methods import METHODS, TITLES, fit_method
from tools.reproduce.semantic.protocols import PROTOCOLS, Case, has_protocol, make_case
from tools.reproduce.semantic.scenes import load_scene, scene_names
from tools.runs.kept import cached_run

KEYS = (
    *("miou", "accuracy", "wrong_auroc", "wrong_auroc_unseen", "unobserved_auroc", "brier"),
    *("train_s", "infer_s", "train_cpu_s", "infer_cpu_s", "peak_rss_mb", "size"),
)
"""Figures of a run. infer_s is for the test points; wrong_auroc ranks wrong labels by the doubt of the label,
unobserved_auroc ranks unobserved places by p(uncertain) (of methods without it: by what they have), and
wrong_auroc_unseen wrong labels by that, too."""
PAPER = {
    "semantickitti": {"contramap": 0.8412, "hilbert": 0.8096},
    "scenenet": {"contramap": 0.669, "hilbert": 0.662},
}
"""The paper's mIoU: ten first scans, and sixty rooms of which one could be had."""


def miou(truth: np.ndarray, label: np.ndarray) -> float:
    """Intersection over union of labels (N,), averaged over the classes that the truth (N,) holds."""
    scores = []
    for one in np.unique(truth):
        either = (truth == one) | (label == one)
        scores.append(((truth == one) & (label == one)).sum() / either.sum())
    return float(np.mean(scores))


def measure(case: Case, method: str, classes: int, config: MultiscaleConfig, seed: int) -> dict[str, float]:
    """Everything that is measured of one method on one case; see KEYS."""

    def fit() -> Any:
        return fit_method(method, case.X, case.y, classes, config, np.random.default_rng([seed, 1]))

    fitted, training = timed("train", fit, most=1)
    (shares, doubt, unseen), asking = timed("infer", lambda: fitted.ask(case.X_test), most=1)
    label = shares.argmax(axis=1)
    nowhere = fitted.ask(case.unobserved).unseen
    unobserved = np.append(np.zeros(len(unseen), bool), np.ones(len(nowhere), bool))
    return {
        "miou": miou(case.y_test, label),
        "accuracy": float((label == case.y_test).mean()),
        "wrong_auroc": auroc(doubt, label != case.y_test),
        "wrong_auroc_unseen": auroc(unseen, label != case.y_test),
        "unobserved_auroc": auroc(np.append(unseen, nowhere), unobserved),
        "brier": brier(shares.astype(np.float64), case.y_test),
        **training,
        **asking,
        "peak_rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "size": float(fitted.size),
        "train_points": float(len(case.X)),
        "test_points": float(len(case.X_test)),
    }


def run_semantic(
    data: Path,
    out: Path,
    dataset: str,
    protocols: tuple[str, ...] = PROTOCOLS,
    methods: tuple[str, ...] = METHODS,
    sequences: tuple[str, ...] = (),
    seeds: tuple[int, ...] = (0,),
    config: MultiscaleConfig | None = None,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Measure the methods on a data set's scenes; write runs, summary.json and table.md under `out`.

    A run that is already under out/runs with the same settings is not run again. Returns the summary. Raises
    ConfigError for unknown names, DataError for missing or broken data.
    """
    from tqdm import tqdm

    config = config or MultiscaleConfig()
    names = scene_names(dataset, sequences)
    check_choices(protocols, PROTOCOLS, "protocols")
    check_choices(methods, METHODS, "methods")
    found: dict[str, dict[str, list[dict[str, float]]]] = {}
    tasks = [(name, protocol, seed) for name in names for protocol in protocols for seed in seeds]
    scene_of = lru_cache(maxsize=1)(lambda name: load_scene(data, dataset, name))
    for name, protocol, seed in tqdm(tasks, desc="cases", disable=None):
        scene = scene_of(name)
        if not has_protocol(scene, protocol):
            continue
        case_of = lru_cache(maxsize=1)(lambda s, p, k: make_case(s, p, np.random.default_rng(k)))
        for method in methods:
            settings = {"scene": name, "protocol": protocol, "seed": seed, "method": method, "keys": [*KEYS]}
            settings |= asdict(config) if method in ("contramap", "hilbert") else {}
            result = cached_run(
                out / "runs" / f"{dataset}-{name}-{protocol}-{method}-{seed}.json",
                settings,
                lambda m=method, s=scene, p=protocol, k=seed, c=case_of: measure(  # type: ignore[misc]
                    c(s, p, k), m, s.classes, config, k
                ),
                overwrite,
            )
            found.setdefault(protocol, {}).setdefault(method, []).append(result)
    sets = {
        dataset if protocol == "points" else f"{dataset}_{protocol}": _summary(by_method)
        for protocol, by_method in found.items()
    }
    summary = {"dataset": dataset, "scenes": list(names), "seeds": list(seeds), "sets": sets}
    write_json(summary, out / "summary.json")
    write_atomically(out / "table.md", semantic_table(summary).encode())
    return summary


def _summary(by_method: dict[str, list[dict[str, float]]]) -> dict[str, Any]:
    """The spread of every figure, and how ContraMap compares scene by scene."""
    from scipy.stats import ttest_rel

    ours = [run["miou"] for run in by_method.get("contramap", [])]
    out: dict[str, Any] = {}
    for method, runs in by_method.items():
        out[method] = {**summarise(runs, KEYS), "runs": len(runs)}
        theirs = [run["miou"] for run in runs]
        if ours and method != "contramap":
            out[method]["contramap_gain"] = float(np.mean(np.subtract(ours, theirs)))
            out[method]["contramap_wins"] = int(np.sum(np.greater(ours, theirs)))
            if len(ours) > 2 and np.ptp(np.subtract(ours, theirs)) > 0:
                out[method]["p_value"] = float(ttest_rel(ours, theirs).pvalue)
    return out


def semantic_table(summary: dict[str, Any]) -> str:
    """The sets of a summary in markdown, with the paper's mIoU beside ours."""
    rows = []
    for name, methods in summary["sets"].items():
        for method, found in methods.items():
            paper = PAPER.get(name, {}).get(method)
            gain = found.get("contramap_gain")
            compared = "" if gain is None else f"{gain:+.4f} ({found['contramap_wins']}/{found['runs']}"
            compared += f", p {found['p_value']:.3f})" if "p_value" in found else ")" if compared else ""
            rows.append(
                [
                    name,
                    TITLES[method],
                    f"{found['miou']['mean']:.4f} ± {found['miou']['std']:.4f}",
                    "" if paper is None else f"{paper:.4f}",
                    compared,
                    *(f"{found[key]['mean']:.3f}" for key in KEYS[1:6]),
                    *(
                        f"{seconds(found[key + '_cpu_s']['median'])} ({seconds(found[key + '_s']['median'])})"
                        for key in ("train", "infer")
                    ),
                ]
            )
    header = [
        *(
            "set",
            "method",
            "mIoU",
            "paper's",
            "ContraMap's gain (wins)",
            "accuracy",
            "AUROC wrong",
            "by p(uncertain)",
        ),
        *("AUROC unobserved", "Brier", "training, CPU (wall) [s]", "asking [s]"),
    ]
    return markdown_table([header, *rows])
