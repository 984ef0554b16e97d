"""What planes between objects took too much of is put back: pieces of the parts that were cut.

A plane ends a whole part because of one corner of a neighbour. Where that leaves much of a mesh without a
part, planes that pass by the lacking place instead leave another piece of the same part. Knows meshes and
convex parts in one frame; knows nothing of formats.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import trimesh

from reconstruction.export.apart import Parts, below, boxes
from reconstruction.export.hulls import Hull
from reconstruction.export.parts_error import Union, surface_points
from reconstruction.solid import Solid

LIMIT = 0.0028
"""A place of a mesh further than this from its parts lacks one [m]."""
REACH, SPACING = 0.0025, 0.0005
"""A piece holds a place no further than this from the lacking one, of a lattice so fine [m]."""
ROOM = 0.0001
"""That place is so much further from others than it has to be [m]: what is thinner is no piece."""
MOST = 24
"""Pieces put back for an object at most."""


def put_back(
    apart: Mapping[int, Parts], whole: Mapping[int, Parts], meshes: Mapping[int, trimesh.Trimesh], gap: float
) -> dict[int, Parts]:
    """Label -> convex parts [m], with pieces of the `whole` ones where those that were kept `apart` lack more
    than LIMIT of a mesh.

    meshes: what the parts stand for. No piece is nearer than `gap` [m] to a part of another object.
    """
    found = dict(apart)
    lacks = {label: _lacking(apart[label], meshes[label]) for label in apart if apart[label] != whole[label]}
    # Who lacks most takes first.
    for label in sorted(lacks, key=lambda label: -lacks[label][1].max(initial=0.0)):
        places, depths = lacks[label]
        if len(places):
            others = [part for other, parts in found.items() if other != label for part in parts]
            found[label] += tuple(_pieces(places, depths, whole[label], others, gap))
    return found


def _lacking(parts: Parts, mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Places (N, 3) of a mesh further than LIMIT from all parts, and how far (N,) [m]."""
    points = surface_points(mesh)
    depths = Union(parts).lacking(points, LIMIT)
    lacks = depths > 0
    return points[lacks].astype(float), depths[lacks]


def _pieces(
    places: np.ndarray, depths: np.ndarray, whole: Parts, others: Parts | list[Hull], gap: float
) -> list[Hull]:
    """Pieces of the parts `whole`, `gap` [m] away from `others`, that places (N, 3) lack by depths (N,)."""
    found: list[Hull] = []
    depths = depths.copy()
    own, theirs = boxes(whole), boxes(others)
    while len(found) < MOST and depths.max(initial=0.0) > LIMIT:
        worst = int(depths.argmax())
        near = np.flatnonzero(
            ((own[:, 0] <= places[worst] + REACH) & (own[:, 1] >= places[worst] - REACH)).all(1)
        )
        piece = _piece(places[worst], [whole[number] for number in near], others, theirs, gap)
        if piece is None:
            depths[worst] = 0.0
            continue
        found.append(piece)
        left = np.flatnonzero(depths)
        points, solid = places[left].astype(np.float32), Solid(piece.mesh)
        depths[left] = np.minimum(depths[left], np.where(solid.inside(points), 0.0, solid.distance(points)))
        depths[worst] = 0.0
    return found


def _piece(
    place: np.ndarray, whole: list[Hull], others: Parts | list[Hull], limits: np.ndarray, gap: float
) -> Hull | None:
    """What of one of the parts `whole` is on the place's side of all others, in boxes (N, 2, 3)."""
    best, most = None, 0.0
    around = place + _ball()
    for part in whole:
        inside = around[(around @ part.face_normals.T <= part.heights).all(1)]
        near = np.flatnonzero(
            ((limits[:, 0] < part.bounds[1] + gap) & (limits[:, 1] > part.bounds[0] - gap)).all(1)
        )
        for number in near:
            if len(inside) == 0:
                break
            other = others[number]
            inside = inside[((inside @ other.face_normals.T - other.heights).max(1) >= gap + ROOM)]
        if len(inside) == 0:
            continue
        start = inside[np.linalg.norm(inside - place, axis=1).argmin()]
        piece: Hull | None = part
        for number in near:
            other = others[number]
            face = (other.face_normals @ start - other.heights).argmax()
            assert piece is not None
            piece = below(piece, -other.face_normals[face], -other.heights[face] - gap)
            if piece is None:
                break
        if piece is not None and piece.volume > most:
            best, most = piece, piece.volume
    return best


def _ball() -> np.ndarray:
    """Offsets (N, 3) [m] of a lattice within REACH."""
    steps = np.arange(-REACH, REACH + SPACING / 2, SPACING)
    offsets = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(-1, 3)
    return offsets[np.linalg.norm(offsets, axis=1) <= REACH]
