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
MOST = 0.12
"""Share of an object's points that another view may contradict: outlines are known to a pixel only."""
AROUND = 2
"""Rays pass a point only where all pixels this near to its own look beyond it [px]."""
FEW = 600
"""Points of an object that are asked."""


@dataclass(frozen=True)
class Left:
    """A view, or one object in it, that most others contradict. share: of its points, by the median view."""

    view: int
    label: int | None
    share: float


def passed(space: Space, points: np.ndarray, config: PerceptionConfig) -> np.ndarray:
    """Which points (N, 3) rays of a view have clearly passed: (N,) bool."""
    import cv2

    depth = np.where(np.isfinite(space.depth), space.depth, np.float32(0))  # unknown: nothing passed there
    if space.guessed is not None:
        depth = np.where(space.guessed, np.float32(0), depth)
    size = 2 * AROUND + 1
    nearest = cv2.erode(depth, np.ones((size, size), np.uint8)).reshape(-1)
    sight = space.look(points)
    measured = nearest[np.maximum(sight.pixel, 0)]
    margin = config.surface_margin + NOISES * config.depth_noise * measured**2
    return np.asarray((sight.pixel >= 0) & (measured > 0) & (sight.depth < measured - margin))


def contradictions(
    views: Sequence[View], spaces: Sequence[Space], config: PerceptionConfig
) -> dict[int, np.ndarray]:
    """For each label (V, V): the share of an object's points in one view that rays of the other passed, or
    the other way round, whichever is more; NaN where neither view sees the object."""
    count = len(views)
    found: dict[int, np.ndarray] = {}
    for a, view in enumerate(views):
        for item in view.observation.objects:
            shares = found.setdefault(item.label, np.full((count, count), np.nan))
            points = item.points[:: 1 + len(item.points) // FEW]
            for b in range(count):
                if a != b:
                    share = float(passed(spaces[b], points, config).mean())
                    shares[a, b] = shares[b, a] = np.fmax(shares[a, b], share)
    return found


def to_leave_out(shares: dict[int, np.ndarray], seen: Sequence[Sequence[int]]) -> list[Left]:
    """Which views, or objects in them, to leave out, the worst first.

    shares: by label, of `contradictions`; seen: labels of the objects that each view sees. One is left out as
    long as the middle one of the others contradicts it; of two views alone the later goes, or what it says
    where the first sees an object.
    """
    left: list[Left] = []
    gone: set[tuple[int, int]] = set()
    whole: set[int] = set()
    while True:
        worst = (MOST, -1, -1)
        for label, table in shares.items():
            alive = [v for v in range(len(table)) if v not in whole and (v, label) not in gone]
            for v in alive:
                if label not in seen[v] and len(alive) > 2:
                    continue
                others = [table[v, u] for u in alive if u != v and np.isfinite(table[v, u])]
                if not others:
                    continue
                share = float(np.quantile(others, 0.5, method="lower"))
                if share > worst[0] or (share == worst[0] and v > worst[1] >= 0):
                    worst = (share, v, label)
        share, view, label = worst
        if view < 0:
            return _whole(left, whole)
        gone.add((view, label))
        left.append(Left(view, label, share))
        own = [number for number in seen[view]]
        lost = [number for number in own if (view, number) in gone]
        if own and len(lost) > len(own) / 2:
            whole.add(view)


def _whole(left: list[Left], whole: set[int]) -> list[Left]:
    """The same with one entry for each view that goes as a whole."""
    kept = [entry for entry in left if entry.view not in whole]
    for view in sorted(whole):
        kept.append(Left(view, None, max(entry.share for entry in left if entry.view == view)))
    return kept


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
    wide = cv2.dilate(mask.reshape(space.depth.shape), np.ones((2 * AROUND + 1,) * 2, np.uint8))
    return np.flatnonzero(wide)
