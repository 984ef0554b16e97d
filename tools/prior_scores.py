"""How good a prior's network is at hidden points of objects whose truth is known.

Knows examples and networks; knows nothing of how either was made.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch

from reconstruction.prior.network import PriorNetwork
from tools.evaluation.statistics import calibration_error, reliability
from tools.prior_batches import Batches, odds


def score(network: PriorNetwork, batches: Batches) -> dict:
    """Loss, IoU (mean over objects and by family), Brier score and calibration error at hidden points."""
    examples = batches.examples
    network.eval()
    with torch.inference_mode():
        said = np.concatenate(
            [odds(network, batches.at(rows)).cpu().numpy() for rows in chunks(len(batches), 16)]
        )
    probability, truth = 1 / (1 + np.exp(-said)), examples.truth
    loss = np.logaddexp(0, said) - truth * said
    inside = probability > 0.5
    union = (inside | truth).sum(axis=1)
    iou = (inside & truth).sum(axis=1)[union > 0] / union[union > 0]
    families = examples.family[union > 0]
    return {
        "objects": len(examples),
        "loss": round(float(loss.mean()), 4),
        "iou": round(float(iou.mean()), 4),
        "brier": round(float(((probability - truth) ** 2).mean()), 4),
        "ece": round(calibration_error(reliability(probability.ravel(), truth.ravel())), 4),
        "iou_by_family": {
            str(name): round(float(iou[families == name].mean()), 3) for name in np.unique(families)
        },
    }


def chunks(count: int, size: int) -> Iterator[np.ndarray]:
    for start in range(0, count, size):
        yield np.arange(start, min(start + size, count))
