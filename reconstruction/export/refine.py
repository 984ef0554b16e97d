"""Convex parts that bulge out of their mesh cut in two until they do not. Knows closed meshes only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh

from reconstruction.export.hulls import as_mesh, convex_hull
from reconstruction.solid import Solid

SPACING = 0.0025
"""Points looked at on a part are about this far apart [m], its vertices beside them."""
SAMPLES = (60, 800)
"""At least and at most so many of them on a part."""
ROUNDS = 12
"""Times that a part is halved at most."""
MOST_PARTS = 400
"""Above this many parts none is cut any more: engines get slow."""


def refined(
    parts: Sequence[np.ndarray], mesh: trimesh.Trimesh, simple: trimesh.Trimesh, limit: float
) -> list[trimesh.Trimesh]:
    """Convex parts of a closed mesh, given by their points (N, 3) [m], halved until none bulges out of it by
    more than `limit` [m] where that can be had.

    simple: the mesh with fewer triangles, which is what is cut: the time is that of its triangles. One that
    is not manifold keeps its parts.
    """
    import manifold3d

    given = manifold3d.Mesh(np.asarray(simple.vertices, np.float32), np.asarray(simple.faces, np.uint32))
    body = manifold3d.Manifold(given)
    if body.status() != manifold3d.Error.NoError or body.is_empty():
        return [hull for part in parts if (hull := convex_hull(part)) is not None]
    solid = Solid(mesh)
    todo = [_Part(hull) for part in parts if (hull := convex_hull(part)) is not None]
    done: list[_Part] = []
    for _ in range(ROUNDS):
        if not todo or len(done) + len(todo) > MOST_PARTS:
            break
        worst = bulges([part.hull for part in todo], solid)
        done += [part for part, (depth, _) in zip(todo, worst) if depth <= limit]
        todo = [
            half
            for part, (depth, place) in zip(todo, worst)
            if depth > limit
            for half in _halves(part, place, body)
        ]
    return [part.hull for part in done + todo]


@dataclass(frozen=True)
class _Part:
    """A convex part, and what of the body it is the hull of once that has been worked out."""

    hull: trimesh.Trimesh
    within: Any = None


def bulges(parts: Sequence[trimesh.Trimesh], solid: Solid) -> list[tuple[float, np.ndarray]]:
    """How far each convex part reaches out of the solid at most [m], and where (3,)."""
    clouds = []
    for part in parts:
        count = int(np.clip(part.area / SPACING**2, *SAMPLES))
        drawn, _ = trimesh.sample.sample_surface(part, count, seed=0)
        clouds.append(np.concatenate([part.vertices, drawn]).astype(np.float32))
    everything = np.concatenate(clouds)
    outside = ~solid.inside(everything)
    depth = np.zeros(len(everything))
    depth[outside] = solid.distance(everything[outside])
    found = []
    for cloud, own in zip(clouds, np.split(depth, np.cumsum([len(cloud) for cloud in clouds])[:-1])):
        found.append((float(own.max()), cloud[own.argmax()]))
    return found


def _halves(part: _Part, place: np.ndarray, body: Any) -> list[_Part]:
    """The body within a part on either side of the plane, of three through `place` (3,) and three through its
    middle, that leaves the least hulls; the part itself where that is nothing."""
    import manifold3d

    corners = np.asarray(part.hull.vertices)
    # A half lies within its whole: only the first cut looks at all of the body.
    within = manifold3d.Manifold.hull_points(corners) ^ body if part.within is None else part.within
    surface = within.to_mesh64()
    points, faces = np.asarray(surface.vert_properties[:, :3]), np.asarray(surface.tri_verts)
    edges = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    edges = edges[edges[:, 0] < edges[:, 1]]  # of a closed surface, each once
    _, _, axes = np.linalg.svd(corners - corners.mean(0), full_matrices=False)
    planes = [(axis, float(axis @ through)) for through in (place, points.mean(0)) for axis in axes]
    for axis, height in sorted(planes, key=lambda plane: _size(points, edges, *plane)):
        sides = within.split_by_plane(axis, height)
        meshes = [mesh for side in sides if (mesh := as_mesh(side.hull())) is not None]
        if len(meshes) == 2:
            return [_Part(mesh, side) for mesh, side in zip(meshes, sides)]
    return [part]


def _size(points: np.ndarray, edges: np.ndarray, axis: np.ndarray, level: float) -> float:
    """Volume [m^3] of the hulls of a body's corners (N, 3) and edges (M, 2) on either side of axis x = level.

    Nothing is cut: that would take four times as long.
    """
    import manifold3d

    height = points @ axis - level
    above = height > 0
    begin, end = edges[above[edges[:, 0]] != above[edges[:, 1]]].T
    share = (height[begin] / (height[begin] - height[end]))[:, None]
    there = points[begin] + share * (points[end] - points[begin])
    sides = (np.concatenate([points[side], there]) for side in (above, ~above))
    return sum(manifold3d.Manifold.hull_points(side).volume() for side in sides)
