"""Objects whose foot nobody saw (from straight above, cut by the image's border, behind others) do not hover.

Knows what is seen of one object, its support and what the prior guesses; knows nothing of labels or the fit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import expit

from perception.observation import NOTHING, SUPPORT, Observation, ObservedObject
from perception.quantiles import quantiles
from perception.space import Space
from reconstruction.prior.evidence import hidden_labels
from reconstruction.prior.features import ObjectBox
from reconstruction.prior.footprint import CELLS, Footprint
from reconstruction.samples.bed import bed_height

FOOT_GAP = 0.02
"""An object whose visible part ends higher above its support than this may lack a foot [m]."""
LOW_SHARE = 0.1
"""Seen from above, the lowest tenth of what is seen of it is no foot, but a handle or spout."""
STANDING = 0.5
"""It stands where it is as probable as this on its support: then it lacks no foot."""
COVERED = 0.5
"""It lies on something else where that stands under more than this share of it."""
REACH_DOWN = 0.75
"""Such an object goes down to its support with this probability where it is above: unsure, but there."""
STEEP = 0.95
"""Cosine between the line of sight and the support's normal from which on a top hides the foot under it."""
BORDER = 2
"""An object whose pixels come this near to the image's border goes on beyond it [px]."""
END = 0.01
"""The end of what is seen of an object is its lowest centimetre [m]."""
PROBES, PROBED = 6, 60
"""So many places are asked for under each of so many of its points."""
HIDDEN = 0.8
"""Its foot is behind others when these hide more than this share of them."""
WELL_BEFORE = 0.03
"""... and the places right under its end lie this far behind them: what it touches there may carry it [m]."""
JUST_UNDER = 0.006
"""Where an object is above is asked this far under the end of its visible part [m]."""
EDGE = 0.002
"""A place this far within the outline of what is seen above it lies under it with some certainty [m]."""
NARROW = 0.4
"""Parts narrower than this share of the widest, seen from above, need not go down: handles and spouts."""


def may_lack_foot(item: ObservedObject, observation: Observation, space: Space) -> bool:
    """Whether what is seen of an object ends above its support because nobody could see more of it."""
    if visible_end(item, space) - item.floor <= FOOT_GAP:
        return False
    if seen_from_above(item, space) or observation.at_border(item, BORDER):
        return True
    return _foot_is_behind_others(item, observation, space)


def _foot_is_behind_others(item: ObservedObject, observation: Observation, space: Space) -> bool:
    """Whether nearly all places straight under the end of what is seen of an object are hidden by others that
    stand well before it."""
    assert observation.seen is not None
    end = item.outline[item.outline[:, 2] < item.bounds[0][2] + END]
    steps = np.linspace(0, 1, PROBES, endpoint=False, dtype=np.float32) + np.float32(0.5 / PROBES)
    under = np.repeat(end[:: 1 + len(end) // PROBED], PROBES, axis=0)
    under[:, 2] = np.resize(item.floor + steps * np.float32(item.bounds[0][2] - item.floor), len(under))
    sight = space.look(under)
    seen = np.where(sight.pixel >= 0, observation.seen.reshape(-1)[sight.pixel], SUPPORT)
    hidden = (sight.behind > 0) & (seen != SUPPORT) & (seen != NOTHING) & (seen != item.label)
    deeper = end - np.array([0, 0, 1.2 * END], np.float32)
    before = float(np.median(np.nan_to_num(space.look(deeper).behind)))
    return bool(hidden.mean() > HIDDEN and before > WELL_BEFORE)


def visible_end(item: ObservedObject, space: Space) -> float:
    """Height [m] at which what is seen of an object ends; seen from above, the bulk of it."""
    if not seen_from_above(item, space):
        return float(item.bounds[0][2])
    return float(quantiles(item.outline[:, 2], LOW_SHARE)[0])


def seen_from_above(item: ObservedObject, space: Space) -> bool:
    """Whether an object is seen so steeply that its top hides its foot."""
    low, high = item.bounds
    sight = space.origin - (low + high) / 2
    return bool(sight[2] > STEEP * np.sqrt(sight @ sight))


def with_feet(
    views: Sequence[tuple[Observation, Space]], labels: Sequence[int], points: np.ndarray, guess: np.ndarray
) -> None:
    """Give objects that lack a foot one in the guess (N, K+1) at hidden points (N, 3), in place.

    views: each with its space; labels: of the K objects. A foot that most views of an object cannot see may
    be there; the view that sees farthest down says where.
    """
    lacking = []
    for own, label in enumerate(labels, start=1):
        seeing = [
            (float(item.bounds[0][2] - item.floor), number, index)
            for number, (seen, _) in enumerate(views)
            for index, item in enumerate(seen.objects)
            if item.label == label
        ]
        blind = [one for one in seeing if may_lack_foot(views[one[1]][0].objects[one[2]], *views[one[1]])]
        if len(seeing) < 2 * len(blind):
            # It lies on what all of them see it lie on.
            beds = [
                bed_height(views[number][0], views[number][0].objects[index]) for _, number, index in blind
            ]
            known = [bed for bed in beds if bed is not None]
            lacking.append((*min(seeing), own, min(known) if len(known) == len(beds) else None))
    for _, number, index, own, bed in sorted(lacking, key=lambda found: found[0]):
        # The lowest first: what lies on top rests on them.
        reach_down(*views[number], index, points, guess, own, bed)


def reach_down(
    observation: Observation,
    space: Space,
    index: int,
    points: np.ndarray,
    guess: np.ndarray,
    own: int,
    bed: float | None,
) -> None:
    """Give object `index`, class `own`, a foot in the guess (N, K+1) at hidden points (N, 3), in place, if it
    lacks one. bed: height of what it lies on [m], None where that is its support."""
    item = observation.objects[index]
    low, high = item.bounds
    above = seen_from_above(item, space)
    column = ((points[:, :2] > low[:2] - FOOT_GAP) & (points[:, :2] < high[:2] + FOOT_GAP)).all(1)
    column &= points[:, 2] < (high[2] if above else low[2])
    ground_height = item.floor
    if bed is not None and bed > item.floor + FOOT_GAP:
        ground_height = bed  # it lies on something, down to which it goes
        column &= points[:, 2] > bed
    ground = column & (points[:, 2] < ground_height + FOOT_GAP / 4)
    if not ground.any():
        return
    rows = np.flatnonzero(column)
    if above:
        there = _under_plan(item, space, points[rows])
    else:
        there = _under_end(observation, space, index, points[rows])
    foot = ground[rows] & (there > STANDING)
    if (guess[ground, own] > STANDING).any():
        return
    others = guess[rows].sum(1) - guess[rows, 0] - guess[rows, own]
    if foot.any() and (others[foot] > STANDING).mean() > COVERED:
        return  # something else stands where it would: it lies on that
    share = np.maximum(guess[rows, own], REACH_DOWN * there * (1 - others))
    guess[rows, 0] = np.maximum(1 - others - share, 0)
    guess[rows, own] = share


def _under_plan(item: ObservedObject, space: Space, points: np.ndarray) -> np.ndarray:
    """Chance (N,) that an object seen from above goes down through hidden points (N, 3): all that lies under
    what is seen of it, down to the support, but for parts much narrower than the rest."""
    lift = np.array([0, 0, item.floor], np.float32)
    visible = item.outline - lift
    box = ObjectBox.around(visible, space.origin - lift)
    plan = Footprint.of(box, visible)
    local = box.local(points - lift)
    inside, _ = plan.at(box, local)
    there = expit(inside / EDGE)
    cell = np.clip((local[:, :2] + 1) * (CELLS / 2), 0, CELLS - 1).astype(np.int32)
    wide = _without_narrow_parts(plan.distance[0], float(box.size[0]) / CELLS)[cell[:, 0], cell[:, 1]]
    return np.where(wide, there, STANDING * there).astype(np.float32)


def _without_narrow_parts(distance: np.ndarray, cell: float) -> np.ndarray:
    """What is left (n, n) bool of a plan without parts narrower than NARROW of the widest.

    distance: (n, n) [m] to its border, positive inside; cell: side of its cells [m].
    """
    import cv2

    radius = NARROW * float(distance.max())
    core = (distance > radius).astype(np.uint8)
    apart = cv2.distanceTransform(1 - core, cv2.DIST_L2, 5)
    return np.asarray(apart * cell <= radius + cell)


def _under_end(observation: Observation, space: Space, index: int, points: np.ndarray) -> np.ndarray:
    """Chance (N,) that an object whose visible part ends above hidden points (N, 3) goes down through them:
    that it is right under that end, above them."""
    item = observation.objects[index]
    above = points.copy()
    above[:, 2] = item.bounds[0][2] - JUST_UNDER
    there = hidden_labels(observation, space, above)[:, index + 1]
    # Where the visible part itself is right above, no guess is needed.
    apart = cKDTree(item.outline[::2, :2]).query(points[:, :2], distance_upper_bound=2 * JUST_UNDER)[0]
    return np.where(apart < JUST_UNDER, 1.0, there)
