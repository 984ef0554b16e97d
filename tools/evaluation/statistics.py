"""Scores of an uncertainty against what it should tell: ranking, risk and coverage, calibration."""

from __future__ import annotations

import numpy as np
from scipy.stats import rankdata, spearmanr

CALIBRATION_BINS = 15
"""Bins of equal mass in the calibration error."""
CURVE_POINTS = 41
"""Coverages at which a risk-coverage curve is kept for figures."""


def auroc(score: np.ndarray, positive: np.ndarray) -> float:
    """Chance that a positive has a higher score (N,) than a negative, ties half; NaN if either is missing."""
    positive = np.asarray(positive, bool)
    hits, misses = int(positive.sum()), int((~positive).sum())
    if not hits or not misses:
        return float("nan")
    ranks = rankdata(score)
    return float((ranks[positive].sum() - hits * (hits + 1) / 2) / (hits * misses))


def risk_coverage(uncertainty: np.ndarray, wrong: np.ndarray) -> np.ndarray:
    """Error rate (N,) among the i + 1 least uncertain answers, i = 0..N-1; ties share their errors evenly."""
    order = np.argsort(uncertainty, kind="stable")
    errors = np.asarray(wrong, float)[order]
    _, first, count = np.unique(np.asarray(uncertainty)[order], return_index=True, return_counts=True)
    shared = np.repeat(np.add.reduceat(errors, first) / count, count)
    return np.cumsum(shared) / np.arange(1, len(errors) + 1)


def aurc(uncertainty: np.ndarray, wrong: np.ndarray) -> float:
    """Area under the risk-coverage curve: the mean error rate over all coverages; 0 is best."""
    return float(risk_coverage(uncertainty, wrong).mean())


def ause(uncertainty: np.ndarray, wrong: np.ndarray) -> float:
    """AURC above that of an oracle that sorts all errors last."""
    return aurc(uncertainty, wrong) - aurc(np.asarray(wrong, float), wrong)


def curve(risk: np.ndarray) -> list[float]:
    """A risk-coverage curve at CURVE_POINTS evenly spaced coverages from 0 to 1."""
    index = np.round(np.linspace(0, len(risk) - 1, CURVE_POINTS)).astype(int)
    return [float(value) for value in risk[index]]


def brier(probability: np.ndarray, truth: np.ndarray) -> float:
    """Mean squared distance of probabilities (N, K) from the one-hot truth (N,); truth -1 is none of them."""
    target = np.zeros_like(probability)
    known = truth >= 0
    target[np.flatnonzero(known), truth[known]] = 1
    return float((((probability - target) ** 2).sum(1) + ~known).mean())


def reliability(
    confidence: np.ndarray, right: np.ndarray, bins: int = CALIBRATION_BINS
) -> list[tuple[float, float, int]]:
    """(mean confidence, accuracy, count) of bins of equal mass, by rising confidence."""
    order = np.argsort(confidence, kind="stable")
    parts = np.array_split(order, bins)
    return [
        (float(confidence[part].mean()), float(right[part].mean()), len(part)) for part in parts if len(part)
    ]


def calibration_error(bins: list[tuple[float, float, int]]) -> float:
    """Expected calibration error from `reliability` bins: |confidence - accuracy| weighted by count."""
    total = sum(count for *_, count in bins)
    return float(sum(abs(confidence - accuracy) * count for confidence, accuracy, count in bins) / total)


def spearman(a: np.ndarray, b: np.ndarray) -> float:
    """Rank correlation of two arrays (N,); NaN when one of them is constant."""
    if len(a) < 3 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return float("nan")
    return float(spearmanr(a, b).statistic)
