"""The uncertainty card: does an uncertainty know what is hidden, and where the answer is wrong?"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from tools.evaluation.case import CardVoxels
from tools.evaluation.statistics import (
    aurc,
    auroc,
    ause,
    brier,
    calibration_error,
    curve,
    reliability,
    risk_coverage,
)


def uncertainty_card(
    probability: np.ndarray, uncertainty: np.ndarray, voxels: CardVoxels
) -> tuple[dict[str, float], dict[str, Any]]:
    """Scores of uncertainty (N,) and probabilities (N, K+1) on the card's voxels, and curves for figures.

    Voxels out of view say nothing about seen and occluded; they count in all other scores.
    """
    wrong = probability.argmax(1) != voxels.truth
    bins = reliability(probability.max(1), ~wrong)
    scores = {
        **ranking_scores(uncertainty, wrong, voxels),
        "brier": brier(probability, voxels.truth),
        "ece": calibration_error(bins),
        "error_rate": float(wrong.mean()),
    }
    return scores, {"risk": curve(risk_coverage(uncertainty, wrong)), "reliability": bins}


def ranking_scores(uncertainty: np.ndarray, wrong: np.ndarray, voxels: CardVoxels) -> dict[str, float]:
    """How an uncertainty (N,) ranks occluded voxels and wrong answers (N,) bool."""
    known = voxels.occluded | voxels.seen
    return {
        "occlusion_auroc": auroc(uncertainty[known], voxels.occluded[known]),
        "error_auroc": auroc(uncertainty, wrong),
        "error_auroc_occluded": auroc(uncertainty[voxels.occluded], wrong[voxels.occluded]),
        "aurc": aurc(uncertainty, wrong),
        "ause": ause(uncertainty, wrong),
    }


def distance_to_samples(points: np.ndarray, samples: np.ndarray) -> np.ndarray:
    """The simplest uncertainty of all: distance (N,) [m] from points to the nearest sample (M, 3)."""
    return cKDTree(samples).query(points)[0]
