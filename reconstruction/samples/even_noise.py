"""Noise that ignores what the camera saw, for ablations of where the uncertain class gets its samples."""

from __future__ import annotations

import numpy as np

from perception.observation import Observation

NEAR = 0.05
"""Noise near objects lies within this distance of an object's box [m]."""


def spread_evenly(
    observation: Observation,
    points: np.ndarray,
    labels: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    near: bool,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Points (M, 3) [m] and labels (M, C+1): samples (N, 3) with their share of "uncertain" moved elsewhere.

    A sample stays, with its known label, with the chance that it is not "uncertain"; as many noise samples
    as there was "uncertain" in all lie evenly in the box low..high or, with `near`, in its part near objects.
    """
    uncertain = labels[:, -1].copy()
    kept = rng.random(len(points)) >= uncertain
    known = labels[kept]
    known[:, -1] = 0
    known /= known.sum(1, keepdims=True)
    count = round(float(uncertain.sum()))
    noise = np.empty((0, 3), np.float32)
    while len(noise) < count:
        drawn = rng.uniform(low, high, (2 * count, 3)).astype(np.float32)
        noise = np.concatenate([noise, drawn[observation.near_objects(drawn, NEAR)] if near else drawn])
    one_hot = np.tile(np.eye(labels.shape[1], dtype=labels.dtype)[-1], (count, 1))
    return np.concatenate([points[kept], noise[:count]]), np.concatenate([known, one_hot])
