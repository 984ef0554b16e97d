"""What several views measured of surfaces, read as one: the same questions as of one view, one answer.

Knows the readings of single views; knows nothing of maps, lattices or meshes. Free for one view is
free. Where several see the same surface, their distances are averaged, the nearer view counting more: the
least of them would carve away their noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mapping.compiled import compiled
from perception.views.joint import JointObservation
from reconstruction.surface.reading import FAR, Reading
from reconstruction.surface.seen_surface import Edges, SeenSurface, seen_by

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
_FAR, _OPPOSED = np.float32(FAR), np.float32(OPPOSED)


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
            views.append(seen_by(view.observation, view.frame.depth))
            place = {label: index for index, label in enumerate(view.labels)}
            own.append(tuple(place.get(item.label, UNSEEN) for item in observation.objects))
        return cls(tuple(views), tuple(own), floors, thinnest)

    def edges(self, index: int) -> JointEdges:
        """The edges of one object's images; the same when asked again."""
        if index not in self._edges:
            self._edges[index] = self._edges_of(index)
        return self._edges[index]

    @cached_property
    def _edges(self) -> dict[int, JointEdges]:
        return {}

    def _edges_of(self, index: int) -> JointEdges:
        edges = tuple(seen.edges(own[index]) for seen, own in zip(self.views, self.own))
        depths = [view.usual_depth for view in edges]
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

    @property
    def noise(self) -> float:
        """Standard deviation of what the noisiest view measured of the object [m]."""
        return max(edges.noise for edges in self.views)

    def read(self, points: np.ndarray) -> Reading:
        """What all depth images say of points (N, 3) float32 [m]."""
        points = np.ascontiguousarray(points, np.float32)
        readings = np.empty((len(self.views), 3, len(points)), np.float32)
        for edges, own in zip(self.views, readings):
            edges.read_into(points, own)
        return self.together(points, readings)

    def together(self, points: np.ndarray, readings: np.ndarray) -> Reading:
        """What readings (V, 3, N) of points (N, 3) float32 [m] come to: of each view a Reading's arrays."""
        weights = np.array(self.weights, np.float32)
        distance, depth, of_others, nearest = _joined(readings, weights, self.spread)
        if self.thinnest > 0:
            self._thicken(distance, depth, points, nearest)
        np.minimum(distance, self.above_floor(points[:, 2]), out=distance)
        return Reading(distance, depth, of_others)

    def _thicken(
        self, distance: np.ndarray, depth: np.ndarray, points: np.ndarray, nearest: np.ndarray
    ) -> None:
        """Move points (N, 3) that are before what one view sees, and behind its other side that another view
        sees, into it where it is thinner than `thinnest`: between lattice nodes it would be lace. nearest:
        (N,) the view whose distance is least."""
        # Where no view sees the object right before the point, it is as thick as that or more.
        thin = (distance < 0) & (distance > -self.thinnest) & (depth < np.float32(self.thinnest) - distance)
        between = np.flatnonzero(thin)
        if not len(between):
            return
        normals = np.empty((len(self.views), len(between), 3), np.float32)
        behind = np.empty(normals.shape[:2], np.float32)
        points = points[between]
        for view, edges in enumerate(self.views):
            normals[view], behind[view] = edges.facing(points)
        front = normals, behind, nearest[between]
        distance[between] = _thickened(distance[between], *front, np.float32(self.thinnest))

    def behind(self, points: np.ndarray, distance: float) -> np.ndarray:
        """Points (N, 3) moved by `distance` [m] away from each camera in turn."""
        return np.concatenate([edges.behind(points, distance) for edges in self.views])

    def above_floor(self, height: np.ndarray) -> np.ndarray:
        """How far heights (N,) are above the floor [m], FAR where none is known."""
        if self.floor is None:
            return np.full(len(height), np.float32(FAR))
        return height - np.float32(self.floor)


def normals_of(edges: Edges | JointEdges, points: np.ndarray) -> np.ndarray:
    """Normals (N, 3) into the object at points (N, 3) measured of it, 0 where no view shows one there."""
    if isinstance(edges, Edges):
        return edges.facing(points)[0]
    normals = np.zeros_like(points)
    least = np.full(len(points), np.inf, np.float32)
    for view in edges.views:
        found, behind = view.facing(points)
        better = found.any(1) & (np.abs(behind) < least)
        normals[better], least[better] = found[better], np.abs(behind[better])
    return normals


@compiled
def _joined(
    readings: np.ndarray, weights: np.ndarray, spread: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of readings (V, 3, N): the mean (N,) of distances within `spread` of the least; the least depth; the
    least one below others, FAR where no view sees any; and the view of the least distance."""
    distances, depths, others = readings[:, 0], readings[:, 1], readings[:, 2]
    views, count = distances.shape
    distance, depth = np.empty(count, np.float32), np.empty(count, np.float32)
    of_others, nearest = np.empty(count, np.float32), np.empty(count, np.int64)
    for i in range(count):
        first, deep, other = 0, depths[0, i], _FAR
        for v in range(views):
            if distances[v, i] < distances[first, i]:
                first = v
            deep = min(deep, depths[v, i])
            if others[v, i] > 0:
                other = min(other, others[v, i])
        limit = distances[first, i] + np.float32(spread)
        total = sums = np.float32(0)
        for v in range(views):
            if distances[v, i] <= limit and distances[v, i] < _FAR:
                total += weights[v]
                sums += weights[v] * distances[v, i]
        distance[i] = sums / max(total, np.float32(1e-6)) if total > 0 else _FAR
        depth[i], of_others[i], nearest[i] = deep, other, first
    return distance, depth, of_others, nearest


@compiled
def _thickened(
    before: np.ndarray, normals: np.ndarray, behind: np.ndarray, nearest: np.ndarray, thinnest: float
) -> np.ndarray:
    """Distances (N,) of points before what the view `nearest` (N,) sees, moved into a thing that is thinner
    than `thinnest` where another view sees its other side. normals: (V, N, 3), behind: (V, N), as facing
    gives them."""
    moved = before.copy()
    for i in range(len(before)):
        front = normals[nearest[i], i]
        for v in range(len(normals)):
            other = normals[v, i]
            cosine = front[0] * other[0] + front[1] * other[1] + front[2] * other[2]
            if behind[v, i] >= 0 and cosine < _OPPOSED:
                lacking = thinnest - max(before[i] + behind[v, i], np.float32(0))
                moved[i] = max(moved[i], before[i] + max(lacking, np.float32(0)) / 2)
    return moved
