"""What probably fills hidden points: the learned prior where it can be asked, else a thin shell.

Knows whom to ask, and what no guess may forget: things stand on their supports, and obstacles without a label
have insides. Knows nothing of samples, labels or the fit.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from perception.observation import Observation, ObservedObject
from perception.space import Space
from reconstruction.config import TabletopSamples
from reconstruction.prior.evidence import hidden_labels
from reconstruction.samples.obstacles import with_obstacles

FOOT_GAP = 0.02
"""An object whose visible part ends higher above its support than this may lack a foot [m]."""
STANDING = 0.5
"""It lacks one where nowhere on its support it is as probable as this."""
COVERED = 0.5
"""It lies on something else where that stands under more than this share of it."""
REACH_DOWN = 0.75
"""Such an object goes down to its support with this probability where it is above: unsure, but there."""
STEEP = 0.9
"""Cosine between the line of sight and the support's normal from which on a top hides the foot under it."""
BORDER = 2
"""An object whose pixels come this near to the image's border goes on beyond it [px]."""
JUST_UNDER = 0.006
"""Where an object is above is asked this far under the end of its visible part [m]."""
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
            if gaps[index] > FOOT_GAP and (_seen_from_above(item, space) or _cut_off(item, observation)):
                _reach_down(observation, space, int(index), points, guess)
        return guess
    return _shell(observation, config.shell, points)


def _seen_from_above(item: ObservedObject, space: Space) -> bool:
    """Whether an object is seen so steeply that its top hides its foot."""
    sight = space.origin - np.mean(item.bounds, axis=0)
    return bool(sight[2] > STEEP * np.linalg.norm(sight))


def _cut_off(item: ObservedObject, observation: Observation) -> bool:
    """Whether an object goes on beyond the image."""
    height, width = observation.depth.shape
    rows, columns = np.divmod(item.pixels, width)
    ends = rows.min(), height - 1 - rows.max(), columns.min(), width - 1 - columns.max()
    return bool(min(ends) < BORDER)


def _reach_down(
    observation: Observation, space: Space, index: int, points: np.ndarray, guess: np.ndarray
) -> None:
    """Give object `index` a foot in guess (N, K+1), in place, if it lacks one: seen from straight above, or
    cut by the image's border, nothing is seen of it near its support, but it does not hover."""
    item = observation.objects[index]
    low, high = item.bounds
    column = ((points[:, :2] > low[:2] - FOOT_GAP) & (points[:, :2] < high[:2] + FOOT_GAP)).all(1)
    column &= points[:, 2] < low[2]
    ground = column & (points[:, 2] < item.floor + FOOT_GAP / 4)
    own = index + 1
    if not ground.any() or (guess[ground, own] > STANDING).any():
        return
    rows = np.flatnonzero(column)
    above = points[rows].copy()
    above[:, 2] = low[2] - JUST_UNDER
    there = hidden_labels(observation, space, above)[:, own]
    # Where the visible part itself is right above, no guess is needed.
    apart = cKDTree(item.outline[::2, :2]).query(points[rows, :2], distance_upper_bound=2 * JUST_UNDER)[0]
    there = np.where(apart < JUST_UNDER, 1.0, there)
    others = guess[rows].sum(1) - guess[rows, 0] - guess[rows, own]
    foot = ground[rows] & (there > STANDING)
    if foot.any() and (others[foot] > STANDING).mean() > COVERED:
        return  # something else stands where it would: it lies on that
    share = np.maximum(guess[rows, own], REACH_DOWN * there * (1 - others))
    guess[rows, 0] = np.maximum(1 - others - share, 0)
    guess[rows, own] = share


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
