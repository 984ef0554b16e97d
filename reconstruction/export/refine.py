"""Convex parts that bulge out of their mesh cut in two until they do not. Knows closed meshes only."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import trimesh

from reconstruction.export.hulls import convex_hull
from reconstruction.solid import Solid

SAMPLES = 150
"""Points looked at on each part, beside its vertices."""
ROUNDS = 4
"""Times that a part is halved at most."""
MOST_PARTS = 400
"""Above this many parts none is cut any more: engines get slow."""


def refined(parts: Sequence[np.ndarray], mesh: trimesh.Trimesh, limit: float) -> list[np.ndarray]:
    """Corners (N, 3) [m] of convex parts of a closed mesh, none of which bulges out of it by more than
    `limit` [m] where that can be had.

    A mesh that is not manifold keeps its parts.
    """
    import manifold3d

    given = manifold3d.Mesh(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32))
    body = manifold3d.Manifold(given)
    if body.status() != manifold3d.Error.NoError or body.is_empty():
        return list(parts)
    solid = Solid(mesh)
    todo = [hull for part in parts if (hull := convex_hull(part)) is not None]
    done: list[trimesh.Trimesh] = []
    for _ in range(ROUNDS):
        if not todo or len(done) + len(todo) > MOST_PARTS:
            break
        worst = bulges(todo, solid)
        done += [part for part, (depth, _) in zip(todo, worst) if depth <= limit]
        todo = [
            half
            for part, (depth, place) in zip(todo, worst)
            if depth > limit
            for half in _halves(part, place, body)
        ]
    return [np.asarray(part.vertices) for part in done + todo]


def bulges(parts: Sequence[trimesh.Trimesh], solid: Solid) -> list[tuple[float, np.ndarray]]:
    """How far each convex part reaches out of the solid at most [m], and where (3,)."""
    clouds = []
    for part in parts:
        drawn, _ = trimesh.sample.sample_surface(part, SAMPLES, seed=0)
        clouds.append(np.concatenate([part.vertices, drawn]).astype(np.float32))
    everything = np.concatenate(clouds)
    depth = np.where(solid.inside(everything), 0.0, solid.distance(everything))
    found = []
    for cloud, own in zip(clouds, np.split(depth, np.cumsum([len(cloud) for cloud in clouds])[:-1])):
        found.append((float(own.max()), cloud[own.argmax()]))
    return found


def _halves(part: trimesh.Trimesh, place: np.ndarray, body: Any) -> list[trimesh.Trimesh]:
    """The body within a part on either side of the plane through `place` (3,), of three, that leaves the
    least hulls; the part itself where that is nothing."""
    import manifold3d

    corners = np.asarray(part.vertices)
    within = manifold3d.Manifold.hull_points(corners) ^ body
    _, _, axes = np.linalg.svd(corners - corners.mean(0), full_matrices=False)
    best: tuple[float, list[trimesh.Trimesh]] = (np.inf, [part])
    for axis in axes:
        sides = within.split_by_plane(axis, float(axis @ place))
        corners_of = [np.asarray(side.to_mesh().vert_properties[:, :3], float) for side in sides]
        hulls = [hull for of_one in corners_of if (hull := convex_hull(of_one)) is not None]
        size = sum(hull.volume for hull in hulls)
        if len(hulls) == 2 and size < best[0]:
            best = (size, hulls)
    return best[1]
