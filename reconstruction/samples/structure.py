"""What probably fills hidden points: the learned prior where it can be asked, else a thin shell.

Knows whom to ask, and what no guess may forget: things stand on their supports, and obstacles without a label
have insides. Knows nothing of samples, labels or the fit.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from perception.observation import Observation
from perception.space import Space
from reconstruction.config import TabletopSamples
from reconstruction.prior.evidence import hidden_labels
from reconstruction.samples.obstacles import with_obstacles
from reconstruction.samples.reach_down import may_lack_foot, reach_down

BEFORE_GUESS = 0.7
"""Chance that the ray is free before a surface that was guessed, not measured."""


def structure(
    observation: Observation, space: Space, config: TabletopSamples, points: np.ndarray, obstacles: np.ndarray
) -> np.ndarray:
    """(N, K+1) guess of {empty, object 1..K} at points (N, 3) behind what is seen, none of them under a
    support. With obstacles (M, 3), thinned surface points of what has no label, (N, K+2): they are last."""
    guess = _objects(observation, space, config, points)
    if space.guessed is not None:
        sight = space.look(points)
        early = (sight.pixel >= 0) & space.guessed.reshape(-1)[sight.pixel] & (sight.behind < 0)
        likely = 1 + guess[early, 1:].argmax(1)
        guess[early] = 0
        guess[early, 0] = BEFORE_GUESS
        guess[np.flatnonzero(early), likely] = 1 - BEFORE_GUESS
    return with_obstacles(observation, space, config.shell, points, guess, obstacles)


def _objects(
    observation: Observation, space: Space, config: TabletopSamples, points: np.ndarray
) -> np.ndarray:
    """(N, K+1) guess of {empty, object 1..K} at points (N, 3)."""
    if config.prior == "learned" and observation.support is not None:
        guess = hidden_labels(observation, space, points)
        gaps = [item.bounds[0][2] - item.floor for item in observation.objects]
        for index in np.argsort(gaps, kind="stable"):  # the lowest first: what lies on top rests on them
            item = observation.objects[index]
            if may_lack_foot(item, observation, space):
                reach_down(observation, space, int(index), points, guess)
        return guess
    return _shell(observation, config.shell, points)


def _shell(observation: Observation, shell: float, points: np.ndarray) -> np.ndarray:
    """(N, K+1) guess of {empty, object 1..K} from the distance to each object's seen surface alone."""
    objects = observation.objects
    distance = np.stack([cKDTree(o.outline[::4]).query(points)[0] for o in objects], 1)
    nearest = distance.argmin(1)
    rows = np.arange(len(points))
    inside = 1 / (1 + np.exp((distance[rows, nearest] - shell) / (0.3 * shell)))
    guess = np.zeros((len(points), len(objects) + 1), np.float32)
    guess[rows, nearest + 1] = inside
    guess[:, 0] = 1 - inside
    return guess
