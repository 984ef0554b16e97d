"""Views that contradict each other: what one measured lies where another's rays passed.

Knows views in one table frame with one set of labels. A wrong pose makes one view contradict all others; an
object that was moved makes it contradict them there alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from perception.config import PerceptionConfig
from perception.observation import ObservedObject
from perception.space import Space
from perception.views.joint import View

NOISES = 3.0
"""A ray contradicts a point from this many standard deviations of the depth beyond it on."""
MOST = 0.10
"""Share of an object's points that another view may contradict: outlines are known to a pixel only."""
MOST_EACH = 0.04
"""The same where half of a view's objects, two at least, are contradicted: then the view is wrong."""
PIXELS_A_SIDE = 320
"""Outlines are known to a pixel for each so many in a row of the image."""
FEW = 600
"""Points of an object that are asked."""


@dataclass(frozen=True)
class Left:
    """A view, or one object in it, that most others contradict. share: of its points, by the median view."""

    view: int
    label: int | None
    share: float


def passed(space: Space, nearest: np.ndarray, points: np.ndarray, config: PerceptionConfig) -> np.ndarray:
    """Which points (N, 3) rays of a view have clearly passed: (N,) bool. nearest: of `nearest_around`."""
    sight = space.look(points)
    measured = nearest[np.maximum(sight.pixel, 0)]
    margin = config.surface_margin + NOISES * config.depth_noise * measured**2
    return np.asarray((sight.pixel >= 0) & (measured > 0) & (sight.depth < measured - margin))


def nearest_around(space: Space) -> np.ndarray:
    """The least depth (H W,) [m] around each pixel of a view, 0 where something there is not known."""
    import cv2

    depth = np.where(np.isfinite(space.depth), space.depth, np.float32(0))  # unknown: nothing passed there
    if space.guessed is not None:
        depth = np.where(space.guessed, np.float32(0), depth)
    size = 2 * _around(space) + 1
    return cv2.erode(depth, np.ones((size, size), np.uint8)).reshape(-1)


def _around(space: Space) -> int:
    """Rays pass a point only where all pixels this near to its own look beyond it [px]."""
    return max(1, round(space.camera.width / PIXELS_A_SIDE))


def contradictions(
    views: Sequence[View], spaces: Sequence[Space], config: PerceptionConfig, settled: int = 0
) -> dict[int, np.ndarray]:
    """For each label (V, V): the share of an object's points in one view that rays of the other passed, or
    the other way round, whichever is more; NaN where neither view sees the object. settled: so many of the
    views were found to agree before; 0 among them."""
    count = len(views)
    nearest = [_memo(view, space) for view, space in zip(views, spaces)]
    found: dict[int, np.ndarray] = {}
    for a, view in enumerate(views):
        items = view.observation.objects
        few = [item.points[:: 1 + len(item.points) // FEW] for item in items]
        points, lengths = np.concatenate(few), np.array([len(part) for part in few])
        starts = np.cumsum(lengths) - lengths
        for b in range(count):
            if a == b:
                continue
            if a < settled and b < settled:
                gone = np.zeros(len(items))
            else:
                passed_by = passed(spaces[b], nearest[b], points, config)
                gone = np.add.reduceat(passed_by, starts, dtype=np.int64) / lengths
            for item, share in zip(items, gone.tolist()):
                shares = found.setdefault(item.label, np.full((count, count), np.nan))
                shares[a, b] = shares[b, a] = np.fmax(shares[a, b], share)
    return found


def _memo(view: View, space: Space) -> np.ndarray:
    memo = view.observation.memo
    if "nearest_around" not in memo:
        memo["nearest_around"] = nearest_around(space)
    return np.asarray(memo["nearest_around"])


def to_leave_out(shares: dict[int, np.ndarray], seen: Sequence[Sequence[int]]) -> list[Left]:
    """Which views, or objects in them, to leave out: whole views first.

    shares: by label, of `contradictions`; seen: labels of the objects that each view sees. A view counts as
    contradicted by as much as the middle one of the others says; of two views alone the later goes, or what
    it says where the first sees an object.
    """
    left: list[Left] = []
    alive = list(range(len(seen)))
    while len(alive) > 1:
        scores = {view: [_share(shares[label], view, alive) for label in seen[view]] for view in alive}
        wrong = {view: _whole(found) for view, found in scores.items()}
        worst = max(alive, key=lambda view: (wrong[view], view))
        if wrong[worst] <= 0:
            break
        left.append(Left(worst, None, wrong[worst]))
        alive.remove(worst)
    for label, table in shares.items():
        here = list(alive)
        while len(here) > 1:
            asked = [view for view in here if label in seen[view] or len(here) == 2]
            worst = max(asked, key=lambda view: (_share(table, view, here), view))
            share = _share(table, worst, here)
            if share <= MOST:
                break
            left.append(Left(worst, label, share))
            here.remove(worst)
    return left


def _share(table: np.ndarray, view: int, alive: Sequence[int]) -> float:
    """By how much the middle one of the other views contradicts a view: a share of an object's points."""
    others = [table[view, other] for other in alive if other != view and np.isfinite(table[view, other])]
    return float(sorted(others)[(len(others) - 1) // 2]) if others else 0.0


def _whole(found: Sequence[float]) -> float:
    """The greatest share of those (N,) of a view's objects if they speak against the whole view, else 0."""
    high = sum(share > MOST_EACH for share in found)
    return max(found) if high and high >= max(len(found) / 2, min(2, len(found))) else 0.0


def pixels_at(space: Space, item: ObservedObject | None, places: np.ndarray) -> np.ndarray:
    """Flat pixels of a view that see an object, or look where others see it: at places (N, 3) [m]."""
    import cv2

    mask = np.zeros(space.depth.size, np.uint8)
    if len(places):
        pixel = space.look(places).pixel
        mask[pixel[pixel >= 0]] = 1
    if item is not None:
        mask[item.pixels] = 1
        mask[item.silhouette] = 1
    wide = cv2.dilate(mask.reshape(space.depth.shape), np.ones((2 * _around(space) + 1,) * 2, np.uint8))
    return np.flatnonzero(wide)
