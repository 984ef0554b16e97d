"""What probably fills hidden points: the learned prior where it can be asked, else a thin shell.

Knows whom to ask, and what no guess may forget: things stand on their supports, and obstacles without a label
have insides. Knows nothing of samples, labels or the fit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from mapping.compiled import compiled
from mapping.threads import Threads, map_in_threads
from perception.beside_masks import beside_all_masks
from perception.observation import Observation, ObservedObject
from perception.space import Region, Space
from perception.views.joint_space import each_view
from reconstruction.config import TabletopSamples
from reconstruction.prior.evidence import hidden_labels
from reconstruction.prior.remembered import remembered
from reconstruction.samples.bodies import Body, with_bodies
from reconstruction.samples.obstacles import with_obstacles
from reconstruction.samples.reach_down import with_feet
from reconstruction.samples.silent import silent_in

BEFORE_GUESS = 0.7
"""Chance that the ray is free before a surface that was guessed, not measured."""

BEHIND_OTHERS = 1.6
"""Behind another object an object counts this many times against empty space: place by place it ends where it
is as likely as not, and most of what others hide would be missing."""

HALF_KNOWN = 0.01
"""A view's guess counts half where a point lies this deep behind what it measured [m]."""
OUTSIDE_WEIGHT = 0.02
"""How much it counts where the view measured nothing."""
LEAST_WEIGHT = 1e-3
"""How much where it looks past the point: next to nothing."""
LEAST_SHARE = 0.6
"""A view is not asked where its guess counts less than this, as a share of the one that counts most."""
LEAST_CHANCE = 1e-6
"""No guess is surer than this."""
NOBODYS = -12.0
"""Log odds of an object where no view says anything of it."""


def structure(
    observation: Observation,
    space: Space,
    config: TabletopSamples,
    points: np.ndarray,
    obstacles: np.ndarray,
    bodies: Sequence[Body | None] = (),
) -> tuple[np.ndarray, np.ndarray]:
    """(N, K+1) guess of {empty, object 1..K} at points (N, 3) behind what is seen, none of them under a
    support. With obstacles (M, 3), thinned surface points of what has no label, (N, K+2): they are last. And
    which of the points (N,) lie in a body that is never hollow. bodies: of objects whose whole shape is
    known.
    """
    views = each_view(observation, space)
    guess = (
        _objects(*views[0], config, points).copy()
        if len(views) == 1
        else _all_views(observation, views, config, points)
    )
    if config.prior == "learned" and observation.support is not None:
        with_feet(views, [item.label for item in observation.objects], points, guess)
    if len(views) == 1:
        lean_behind_others(observation, space, points, guess)
    guess, filled = with_bodies(guess, points, bodies)
    if space.guessed is not None:
        sight = space.look(points)
        early = (sight.pixel >= 0) & space.guessed.reshape(-1)[sight.pixel] & (sight.behind < 0)
        likely = 1 + guess[early, 1:].argmax(1)
        guess[early] = 0
        guess[early, 0] = BEFORE_GUESS
        guess[np.flatnonzero(early), likely] = 1 - BEFORE_GUESS
    return with_obstacles(observation, space, config.shell, points, guess, obstacles), filled


def lean_behind_others(observation: Observation, space: Space, points: np.ndarray, guess: np.ndarray) -> None:
    """Let what other objects hide from the only view count more in the guess (N, K+1) of {empty, object
    1..K}."""
    pixel, count = space.pixel_of(points), len(observation.objects)
    # A surface that was guessed is no proof that it hides anything.
    measured = (pixel >= 0) & np.isfinite(observation.depth.reshape(-1)[pixel])
    hides = np.where(measured, observation.owner[pixel], count)
    rows = np.flatnonzero(hides < count)
    more = np.full((len(rows), count), BEHIND_OTHERS, guess.dtype)
    more[np.arange(len(rows)), hides[rows]] = 1
    leaning = guess[rows]
    leaning[:, 1:] *= more
    guess[rows] = leaning / leaning.sum(1, keepdims=True)


def _all_views(
    observation: Observation,
    views: list[tuple[Observation, Space]],
    config: TabletopSamples,
    points: np.ndarray,
) -> np.ndarray:
    """(N, K+1) guess of {empty, object 1..K} at points (N, 3) from the guesses of all views.

    Log odds of an object against "empty" are averaged over the views that see it, each with the more weight
    the less deep a point lies behind what the view measured, and the more it sees of the object; one that
    looks past the point has none, nor has one that said nothing new of the object when it was added.
    """
    place = {item.label: index for index, item in enumerate(observation.objects)}
    odds = np.zeros((len(points), len(place)), np.float32)
    total = np.full_like(odds, LEAST_WEIGHT)
    odds += LEAST_WEIGHT * NOBODYS
    known = np.array(map_in_threads(lambda view: _weight(view[1], points), views))
    silent = silent_in([seen for seen, _ in views])
    # Objects about which the same views are asked share what weight is enough.
    groups = {own: number for number, own in enumerate(dict.fromkeys(silent.values()))}
    enough = np.array(
        [LEAST_SHARE * known[[v not in own for v in range(len(views))]].max(0) for own in groups]
    )
    for number, ((seen, space), weight) in enumerate(zip(views, known)):
        loud = [k for k, item in enumerate(seen.objects) if number not in silent[item.label]]
        group = np.array([groups[silent[seen.objects[k].label]] for k in loud], np.int64)
        asked = np.flatnonzero((weight >= enough[np.unique(group)]).any(0))
        if not len(asked):
            continue
        only = None if len(loud) == len(seen.objects) else tuple(loud)
        guess = _objects(seen, space, config, points[asked], only)
        columns = np.array([[k, place[seen.objects[k].label]] for k in loud])
        areas = np.array([_area(seen.objects[k], space) for k in loud], np.float32)
        of_view = odds, total, columns, weight, areas, enough[group], np.float32(LEAST_CHANCE)
        halves = [(*of_view, asked[part], guess[part]) for part in Threads().split(len(asked))]
        map_in_threads(lambda half: _vote(*half), halves)
    return np.asarray(_shares(odds, total))


@compiled
def _shares(odds: np.ndarray, total: np.ndarray) -> np.ndarray:
    """(N, K+1) shares of "empty" and of objects from log odds against it, each the sum odds (N, K) of votes
    whose weights come to total (N, K)."""
    count, objects = odds.shape
    shares = np.empty((count, objects + 1), np.float32)
    for i in range(count):
        highest = np.float32(0)
        for k in range(objects):
            shares[i, k + 1] = odds[i, k] / total[i, k]
            highest = max(highest, shares[i, k + 1])
        shares[i, 0] = np.exp(-highest)
        whole = shares[i, 0]
        for k in range(1, objects + 1):
            shares[i, k] = np.exp(shares[i, k] - highest)
            whole += shares[i, k]
        for k in range(objects + 1):
            shares[i, k] /= whole
    return shares


@compiled
def _vote(
    odds: np.ndarray,
    total: np.ndarray,
    columns: np.ndarray,
    weight: np.ndarray,
    areas: np.ndarray,
    enough: np.ndarray,
    least: float,
    asked: np.ndarray,
    guess: np.ndarray,
) -> None:
    """Add to odds (N, K), and to the weights total (N, K), what a view guesses (M, 1 + own) of points asked
    (M,): of L of its objects, columns (L, 2): their number in it and among all, with weight (N,) times areas
    (L,), where the weight is `enough` (L, N)."""
    for i in range(len(asked)):
        point = asked[i]
        empty = max(guess[i, 0], least)
        for k in range(len(columns)):
            if weight[point] >= enough[k, point]:
                own, place = weight[point] * areas[k], columns[k, 1]
                odds[point, place] += own * np.log(max(guess[i, columns[k, 0] + 1], least) / empty)
                total[point, place] += own


def _weight(space: Space, points: np.ndarray) -> np.ndarray:
    """How much a view's guess counts at points (N, 3): (N,)."""
    region, behind = space.classify(points), space.depth_behind(points)
    weight = HALF_KNOWN / (HALF_KNOWN + np.maximum(behind, 0))
    weight[(region == Region.OUT_OF_VIEW) | np.isnan(behind)] = OUTSIDE_WEIGHT
    weight[region == Region.FREE] = LEAST_WEIGHT
    return weight


def _area(item: ObservedObject, space: Space) -> float:
    """How much is seen of an object, in units of 10 cm^2 across the line of sight."""
    depth = space.depth.reshape(-1)[item.pixels]
    return float((depth**2).sum()) / float(space.camera.K[0, 0] * space.camera.K[1, 1]) / 1e-3


def _objects(
    observation: Observation,
    space: Space,
    config: TabletopSamples,
    points: np.ndarray,
    only: tuple[int, ...] | None = None,
) -> np.ndarray:
    """(N, K+1) guess of {empty, object 1..K} at points (N, 3). only: objects that are asked about."""
    if config.prior == "learned" and observation.support is not None:

        def ask(points: np.ndarray) -> np.ndarray:
            return hidden_labels(observation, space, points, only=only)

        # When a view is added, most of them are asked again.
        return remembered(observation.memo, ("guess", only), points, ask)
    guess = _shell(observation, config.shell, points)
    beside = beside_all_masks(observation, space, points)
    guess[beside] = 0
    guess[beside, 0] = 1
    return guess


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
