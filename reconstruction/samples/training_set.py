"""The map's training set: samples with label distributions, and hinge points.

Class 0 is empty space, class k the k-th observed object, the last class "uncertain".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class TrainingSet:
    """Samples and hinge points in the table frame.

    X: (N, 3) float32 [m]; y: (N, C+1) float32 label distributions, one-hot where the class is known;
    hinges: (H, 3) float32 [m]; gamma: (H,) float32 [1/m^2].
    """

    X: np.ndarray
    y: np.ndarray
    hinges: np.ndarray
    gamma: np.ndarray


def assemble(
    classes: list[np.ndarray],
    soft: np.ndarray,
    soft_labels: np.ndarray,
    hinges: np.ndarray,
    gamma: np.ndarray,
) -> TrainingSet:
    """One set from samples of each class (hard labels) and samples with label distributions."""
    hard = np.repeat(np.arange(len(classes)), [len(c) for c in classes])
    X = np.concatenate([*classes, soft]).astype(np.float32)
    y = np.zeros((len(X), soft_labels.shape[1]), np.float32)
    y[np.arange(len(hard)), hard] = 1
    y[len(hard) :] = soft_labels
    return TrainingSet(X, y, hinges, gamma.astype(np.float32))
