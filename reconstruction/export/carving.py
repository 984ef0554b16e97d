"""Convex parts hollowed out where a neighbour is: what is too near its mesh is taken away before planes cut.

Planes alone take more than that: where several of a neighbour's parts meet, each has its own. Knows closed
meshes and convex parts in one frame; knows nothing of formats.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from typing import Any

import numpy as np
import trimesh

from reconstruction.export.apart import THICK, Parts, boxes, share_of_thicker
from reconstruction.export.cutting import Cutter, solid_of
from reconstruction.export.hulls import surfaces
from reconstruction.export.refine import bulges, refined
from reconstruction.solid import Solid

LIMIT = 0.0005
"""Parts reach by no more than this into what was taken away [m]; planes cut that off."""
BESIDE = 0.003
"""Surfaces this near to another object's are beside it [m]."""
THINNEST = 0.1
"""Share of the surface beside another object that may be thinner than what counts as its thickness."""
SAMPLES = 4000
"""Points drawn on a mesh to learn how thick it is beside another."""
INWARDS = 1e-4
"""Rays through a mesh begin this far below its surface [m]."""
SIMPLIFY = 0.0002
"""What is taken away is simplified by this much [m]: the time is that of its triangles."""
SHARPEST = 0.5
"""A vertex at a sharper edge than this cosine tells, or at a corner, moves no further."""
SPLINTER = 2e-9
"""Volume of a part that cannot be cut and reaches too far: rather none [m^3]."""


def carved(
    objects: Mapping[int, Parts], meshes: Mapping[int, trimesh.Trimesh], gap: float
) -> dict[int, Parts]:
    """Label -> convex parts [m], without what is so near to a neighbour's mesh that `gap` [m] would not be
    left.

    objects: label -> convex parts; meshes: what they stand for. Of two that touch the thicker one gives more.
    """
    solids = {label: Solid(mesh) for label, mesh in meshes.items()}
    around = boxes([meshes[label] for label in objects])
    grown: dict[int, Any] = {}
    for (i, first), (j, second) in combinations(enumerate(objects), 2):
        if ((around[i, 0] >= around[j, 1] + BESIDE) | (around[j, 0] >= around[i, 1] + BESIDE)).any():
            continue
        one, two = (_thickness(solids[a], solids[b]) for a, b in ((first, second), (second, first)))
        if one is None or two is None:
            continue
        share = share_of_thicker(one, two)
        for label, other, distance in ((first, second, gap * share), (second, first, gap * (1 - share))):
            zone = _grown(meshes[other], distance)
            if zone is not None:
                grown[label] = zone if label not in grown else grown[label] + zone
    return {
        label: _carved(parts, grown[label]) or parts if label in grown else parts
        for label, parts in objects.items()
    }


def _thickness(own: Solid, other: Solid) -> float | None:
    """How thick a closed mesh is where it is beside another [m], at most THICK; None where it is nowhere."""
    points, faces = trimesh.sample.sample_surface(own.mesh, SAMPLES, seed=0)
    low, high = other.mesh.bounds
    there = np.flatnonzero(((points > low - BESIDE) & (points < high + BESIDE)).all(1))
    if len(there) == 0:
        return None
    there = there[other.distance(points[there].astype(np.float32)) < BESIDE]
    if len(there) == 0:
        return None
    inwards = -own.mesh.face_normals[faces[there]]
    through = own.cast(points[there] + INWARDS * inwards, inwards) + INWARDS
    return float(np.quantile(np.minimum(through, THICK), THINNEST))


def _grown(mesh: trimesh.Trimesh, distance: float) -> Any:
    """A `manifold3d.Manifold` of a closed mesh grown by a distance [m]; None where it is no manifold."""
    # Vertices move outwards, further where faces meet at an edge, so that each face moves by the distance.
    along = np.einsum("ijk,ik->ij", mesh.vertex_normals[mesh.faces], mesh.face_normals)
    least = np.ones(len(mesh.vertices))
    np.minimum.at(least, mesh.faces, along)
    away = (distance / np.maximum(least, SHARPEST))[:, None] * mesh.vertex_normals
    return solid_of(np.asarray(mesh.vertices) + away, mesh.faces)


def _carved(parts: Parts, taken: Any) -> Parts:
    """Convex parts of what the solid `taken`, a `manifold3d.Manifold`, leaves of each."""
    import manifold3d

    limits = boxes(parts)
    low, high = limits[:, 0].min(0) - BESIDE, limits[:, 1].max(0) + BESIDE
    taken = taken ^ manifold3d.Manifold.cube(high - low).translate(low)
    if taken.is_empty():
        return parts
    taken = taken.simplify(SIMPLIFY)
    box = np.array(taken.bounding_box()).reshape(2, 3)
    met = (limits[:, 0] < box[1]).all(1) & (limits[:, 1] > box[0]).all(1)
    near = np.flatnonzero(met)
    if len(near) == 0:
        return parts
    left = _Left(taken)
    depths = bulges(surfaces([parts[number] for number in near]), left, LIMIT)
    reaching = {int(number) for number, (depth, _) in zip(near, depths) if depth > LIMIT}
    found = [part for number, part in enumerate(parts) if number not in reaching]
    pieces = []
    for number in sorted(reaching):
        whole = solid_of(*surfaces([parts[number]])[0])
        if whole is None:
            found.append(parts[number])
        elif not (piece := whole - taken).is_empty():
            pieces.append(piece)
    if pieces:
        cutter = Cutter.of_pieces(pieces)
        found += refined(cutter.hulls, left, cutter.halve, LIMIT, splinter=SPLINTER)
    return tuple(found)


class _Left:
    """All space but a solid, a `manifold3d.Manifold`."""

    def __init__(self, taken: Any) -> None:
        surface = taken.to_mesh64()
        vertices = np.array(surface.vert_properties[:, :3])
        self._taken = Solid(trimesh.Trimesh(vertices, np.array(surface.tri_verts), process=False))

    def inside(self, points: np.ndarray) -> np.ndarray:
        """As Solid.inside."""
        return ~self._taken.inside(points)

    def distance(self, points: np.ndarray) -> np.ndarray:
        """As Solid.distance."""
        return self._taken.distance(points)
