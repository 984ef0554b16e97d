"""What several views measured of surfaces, read as one: the same questions as of one view, one answer.

Knows the readings of single views; knows nothing of maps, lattices or meshes. Free for one view is
free. Where several see the same surface, their distances are averaged, the nearer view counting more: the
least of them would carve away their noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from perception.views.joint import JointObservation
from reconstruction.surface.reading import FAR, Reading
from reconstruction.surface.seen_surface import Edges, SeenSurface

NOISES = 3.0
"""Views whose distances differ by no more than this many standard deviations see the same surface ..."""
LEAST_SPREAD = 0.0005
"""... or by no more than this [m] ..."""
OUTLINE = 1.0
"""... or than this [px]: each view knows outlines no better, and all of them would shave the same edge."""
OPPOSED = -0.5
"""Two views see the two sides of a thing where the normals of what they see have no larger dot product."""
UNSEEN = -9
"""Number of an object in a view that does not see it."""


@dataclass(frozen=True)
class JointSurface:
    """All measured surfaces of several views.

    views: with own[v], by joint number, the object's number in that view; floors: each object is above its
    height [m], None where unknown. thinnest: what was seen from both sides is at least this thick [m].
    """

    views: tuple[SeenSurface, ...]
    own: tuple[tuple[int, ...], ...]
    floors: Sequence[float] | None
    thinnest: float = 0.0

    @classmethod
    def of(
        cls, observation: JointObservation, floors: Sequence[float] | None = None, thinnest: float = 0.0
    ) -> JointSurface:
        """The surfaces that a joint observation shows. thinnest: see JointSurface."""
        views, own = [], []
        for view in observation.views:
            memo = view.observation.memo
            if "surface" not in memo:
                memo["surface"] = SeenSurface.of(view.observation, view.frame.depth)
            views.append(memo["surface"])
            place = {label: index for index, label in enumerate(view.labels)}
            own.append(tuple(place.get(item.label, UNSEEN) for item in observation.objects))
        return cls(tuple(views), tuple(own), floors, thinnest)

    def edges(self, index: int) -> JointEdges:
        """The edges of one object's images."""
        edges = tuple(seen.edges(own[index]) for seen, own in zip(self.views, self.own))
        depths = [
            float(np.median(seen.depth[seen.owner == own[index]])) if own[index] != UNSEEN else np.inf
            for seen, own in zip(self.views, self.own)
        ]
        nearest = np.min(depths)
        spread = max(
            max(NOISES * seen.noise * depth**2, OUTLINE * nearest / float(seen.camera.K[0, 0]))
            if np.isfinite(depth)
            else 0.0
            for seen, depth in zip(self.views, depths)
        )
        # A view's noise grows with the square of the depth, its weight falls with the square of that.
        weights = tuple(float((nearest / depth) ** 4) if np.isfinite(depth) else 0.1 for depth in depths)
        floor = None if self.floors is None else self.floors[index]
        return JointEdges(edges, weights, max(LEAST_SPREAD, spread), floor, self.thinnest)


@dataclass(frozen=True)
class JointEdges:
    """One object's edges in each view; weights: of the views; spread: by which one surface differs [m];
    thinnest: see JointSurface."""

    views: tuple[Edges, ...]
    weights: tuple[float, ...]
    spread: float
    floor: float | None
    thinnest: float = 0.0

    def read(self, points: np.ndarray) -> Reading:
        """What all depth images say of points (N, 3) float32 [m]."""
        readings = [edges.read(points) for edges in self.views]
        distance = _same_surface([one.distance for one in readings], self.weights, self.spread)
        if self.thinnest > 0:
            self._thicken(distance, points, readings)
        np.minimum(distance, self.above_floor(points[:, 2]), out=distance)
        depth = np.minimum.reduce([one.depth for one in readings])
        others = np.minimum.reduce(
            [np.where(one.others > 0, one.others, np.float32(FAR)) for one in readings]
        )
        return Reading(distance, depth, others)

    def _thicken(self, distance: np.ndarray, points: np.ndarray, readings: Sequence[Reading]) -> None:
        """Move points (N, 3) that are before what one view sees, and behind its other side that another view
        sees, into it where it is thinner than `thinnest`: between lattice nodes it would be lace."""
        between = np.flatnonzero((distance < 0) & (distance > -self.thinnest))
        if not len(between):
            return
        shown = [edges.facing(points[between]) for edges in self.views]
        first = np.argmin([one.distance[between] for one in readings], axis=0)
        front = np.stack([normals for normals, _ in shown])[first, np.arange(len(between))]
        before = distance[between]
        for normals, behind in shown:
            opposed = (behind >= 0) & ((normals * front).sum(1) < OPPOSED)
            lacking = self.thinnest - np.maximum(before + behind, 0)
            moved = before + np.maximum(lacking, 0) / 2
            distance[between] = np.where(opposed, np.maximum(distance[between], moved), distance[between])

    def behind(self, points: np.ndarray, distance: float) -> np.ndarray:
        """Points (N, 3) moved by `distance` [m] away from each camera in turn."""
        return np.concatenate([edges.behind(points, distance) for edges in self.views])

    def above_floor(self, height: np.ndarray) -> np.ndarray:
        """How far heights (N,) are above the floor [m], FAR where none is known."""
        if self.floor is None:
            return np.full(len(height), np.float32(FAR))
        return height - np.float32(self.floor)


def _same_surface(distances: Sequence[np.ndarray], weights: Sequence[float], spread: float) -> np.ndarray:
    """(N,) mean of the distances (N,) within `spread` of the least one."""
    least = np.minimum.reduce(distances)
    limit = least + np.float32(spread)
    total, sums = np.zeros_like(least), np.zeros_like(least)
    for distance, weight in zip(distances, weights):
        share = np.where((distance <= limit) & (distance < FAR), np.float32(weight), np.float32(0))
        total += share
        sums += share * np.minimum(distance, np.float32(FAR))
    return np.where(total > 0, sums / np.maximum(total, np.float32(1e-6)), np.float32(FAR))
