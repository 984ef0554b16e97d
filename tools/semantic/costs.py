"""What maps of real scans cost: fits, queries, and the same of other methods in one run.

Knows labelled scenes and the methods that are compared; must not know tables. Every measurement is made in a
process of its own.
"""

from __future__ import annotations

import resource
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mapping.errors import DataError
from mapping.multiscale import MultiscaleConfig, MultiscaleMap
from tools.reproduce.semantic.methods import METHODS, SemanticMap, fit_method
from tools.reproduce.semantic.scenes import Scene, load_scene
from tools.stopwatch import Stopwatch

QUERIES = 5_000_000
"""Points that one map is asked for."""
COMPARED = 500_000
"""Points that each method is asked for, to compare them."""
CLASSES = 19
"""Classes of the data set."""
AROUND = 0.3
"""Standard deviation [m] of points that are asked for around those of the scan."""
PIECE = 500_000
"""Points that are drawn at a time."""


@dataclass(frozen=True)
class Trial:
    """One measurement on a sequence's scans. what: a key of `MEASURES`."""

    what: str
    data: Path
    sequence: str
    threads: int
    seed: int


def measure(trial: Trial) -> dict[str, float]:
    """The figures of a trial; in a fresh process."""
    import torch

    torch.set_num_threads(trial.threads)
    scene = load_scene(trial.data, "semantickitti", trial.sequence)
    some = slice(None, None, 30)
    first = scene.first[0]
    warm = MultiscaleMap().fit(first.points[some], first.labels[some], scene.classes, _rng(trial))
    warm.predict_labels(first.points[some])  # loops are compiled
    return MEASURES[trial.what](trial, scene)


def fit_scan(trial: Trial, scene: Scene) -> dict[str, float]:
    """Fit of the first scan."""
    return _fitted(trial, scene)[1]


def fit_merged(trial: Trial, scene: Scene) -> dict[str, float]:
    """Fit of all scans of the sequence as one map."""
    if not scene.following:
        raise DataError(f"sequence {trial.sequence} has one scan; name one with several to map them as one")
    return _fitted(trial, Scene(scene.name, scene.first + scene.following, []))[1]


def ask(trial: Trial, scene: Scene) -> dict[str, float]:
    """Probabilities of all classes at QUERIES points around the first scan's, side by side in memory."""
    model, _ = _fitted(trial, scene)
    asked = around(scene.X, QUERIES, _rng(trial))
    watch = Stopwatch()
    shares, _ = model.predict_known(asked)
    return {**watch.figures("ask"), "peak_mb": peak_mb(), "asked": float(len(shares))}


def compare(trial: Trial, scene: Scene) -> dict[str, float]:
    """Fits of all methods, and the time each needs for the same COMPARED points."""
    X, y = scene.X, scene.y
    asked = around(X, COMPARED, _rng(trial))
    figures: dict[str, float] = {}
    for method in METHODS:
        watch = Stopwatch()
        fitted: SemanticMap = fit_method(method, X, y, scene.classes, MultiscaleConfig(), _rng(trial))
        figures |= watch.figures(f"{method}_fit")
        watch = Stopwatch()
        fitted.ask(asked)
        figures |= watch.figures(f"{method}_ask")
    return figures


MEASURES = {"fit": fit_scan, "merged": fit_merged, "ask": ask, "compare": compare}


def around(X: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Points (count, 3) float32 [m] near those of X (N, 3)."""
    asked = X.astype(np.float32)[rng.integers(0, len(X), count)]
    for start in range(0, count, PIECE):
        part = asked[start : start + PIECE]
        part += rng.normal(0, AROUND, part.shape).astype(np.float32)
    return asked


def peak_mb() -> float:
    """The most memory that this process has had [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _fitted(trial: Trial, scene: Scene) -> tuple[MultiscaleMap, dict[str, float]]:
    X, y = scene.X, scene.y
    watch = Stopwatch()
    model = MultiscaleMap().fit(X, y, scene.classes, _rng(trial))
    return model, {
        **watch.figures("fit"),
        "peak_mb": peak_mb(),
        "points": float(len(X)),
        "classes": float(len(np.unique(y))),
        "hinges": float(len(model.W)),
        "steps": float(model.report.iterations),
    }


def _rng(trial: Trial) -> np.random.Generator:
    return np.random.default_rng([trial.seed, 1])
