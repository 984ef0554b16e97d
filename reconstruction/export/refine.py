"""Convex parts that bulge out of their mesh cut in two until they do not.

Knows which parts bulge and where; whoever cuts them knows how.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
import trimesh

from reconstruction.export.cutting import Surface
from reconstruction.export.hulls import Hull
from reconstruction.solid import Solid

SPACING = 0.0025
"""Points looked at on a part are about this far apart [m], its vertices beside them."""
SAMPLES = (60, 800)
"""At least and at most so many of them on a part."""
CLOSER, CLOSE_SAMPLES = 0.001, 1500
"""The same, and at most so many on a part, on faces that bulge nearly as much as is allowed."""
EDGE_SPACING = 0.001
"""The same on edges of parts that bulge no more than is allowed as far as their faces tell [m]."""
CROWDED = 0.0008
"""Where another mesh is, a part bulges no further than this [m]: it would be cut off, and its mesh with
it."""
NEARLY = 0.0009
"""A face that bulges by so much less than is allowed is looked at closer [m]."""
ROUNDS = 30
"""Times that a part is halved at most."""
MOST_PARTS = 800
"""No more parts than this: engines get slow. Those that bulge most are cut first."""


class Body(Protocol):
    """What parts are of: a Solid, or what answers as one does."""

    def inside(self, points: np.ndarray) -> np.ndarray:
        """As Solid.inside."""

    def distance(self, points: np.ndarray) -> np.ndarray:
        """As Solid.distance."""


def refined(
    parts: Sequence[Surface],
    solid: Body,
    halve: Callable[[Sequence[int], np.ndarray], list[list[Surface]]],
    limit: float,
    beside: Sequence[Solid] = (),
    splinter: float = 0.0,
) -> list[Hull]:
    """Convex parts of a solid [m], halved until none bulges out of it by more than `limit` [m] where that can
    be had.

    halve: as Cutter.halve, of a cutter that has these parts now. beside: where those are it is CROWDED.
    splinter: parts of no more than this volume [m^3] that bulge and cannot be cut are left out.
    """
    todo = list(parts)
    done: list[Surface] = []
    for _ in range(ROUNDS):
        room = MOST_PARTS - len(done) - len(todo)
        if not todo or room <= 0:
            break
        worst = bulges(todo, solid, limit, beside)
        order = sorted(range(len(todo)), key=lambda number: -worst[number][0])
        wanted = sorted(number for number in order[:room] if worst[number][0] > limit)
        places = np.array([worst[number][1] for number in wanted], float).reshape(-1, 3)
        halves = halve(wanted, places) if wanted else []
        whole = {number for number, pair in zip(wanted, halves) if not pair}
        dropped = {number for number in whole if Hull(*todo[number]).volume <= splinter}
        kept = whole - dropped
        done += [part for number, part in enumerate(todo) if number in kept or number not in wanted]
        todo = [half for pair in halves for half in pair]
    return [Hull(*part) for part in done + todo]


def bulges(
    parts: Sequence[Surface], solid: Body, limit: float = np.inf, beside: Sequence[Solid] = ()
) -> list[tuple[float, np.ndarray]]:
    """How far each convex part reaches out of the solid at most [m], and where (3,).

    What seems to reach out by nearly `limit` [m], but not by more, is looked at closer. Where it is CROWDED
    the depth is given in proportion: that counts as `limit`.
    """
    every = np.ones(sum(len(faces) for _, faces in parts), bool)
    clouds = _points_on(parts, every, SPACING, SAMPLES)
    depths = _depths([points for points, _ in clouds], solid, limit, beside)
    found = [(float(own.max()), points[own.argmax()]) for own, (points, _) in zip(depths, clouds)]
    near = [n for n, (depth, _) in enumerate(found) if limit - NEARLY < depth <= limit]
    if near:
        marks = []
        for number in near:
            (points, of_face), own = clouds[number], depths[number]
            marks.append(np.zeros(len(parts[number][1]), bool))
            marks[-1][of_face[own[len(points) - len(of_face) :] > limit - NEARLY]] = True
        kept = [n for n, mark in zip(near, marks) if mark.any()]
        marks = [mark for mark in marks if mark.any()]
    if near and kept:
        closer = _points_on(
            [parts[n] for n in kept], np.concatenate(marks), CLOSER, (SAMPLES[0], CLOSE_SAMPLES)
        )
        depths = _depths([points for points, _ in closer], solid, limit, beside)
        for number, own, (points, _) in zip(kept, depths, closer):
            if own.max() > found[number][0]:
                found[number] = (float(own.max()), points[own.argmax()])
    fine = (
        [n for n, (depth, _) in enumerate(found) if 0 < depth <= limit]
        if EDGE_SPACING < limit < np.inf
        else []
    )
    if fine:
        along = [_along_edges(*parts[n]) for n in fine]
        for number, own, points in zip(fine, _depths(along, solid, limit, ()), along):
            if len(own) and own.max() > found[number][0]:
                found[number] = (float(own.max()), points[own.argmax()])
    return found


def _depths(
    clouds: Sequence[np.ndarray], solid: Body, limit: float, beside: Sequence[Solid]
) -> list[np.ndarray]:
    """How far the points (N, 3) of each cloud are out of the solid [m], 0 within; as `bulges` says."""
    everything = np.concatenate(clouds)
    outside = ~solid.inside(everything)
    depth = np.zeros(len(everything))
    depth[outside] = solid.distance(everything[outside])
    for other in beside:
        far = np.flatnonzero((depth > CROWDED) & (depth <= limit))
        depth[far[other.inside(everything[far])]] *= limit / CROWDED
    return np.split(depth, np.cumsum([len(cloud) for cloud in clouds])[:-1])


def _points_on(
    parts: Sequence[Surface], wanted: np.ndarray, spacing: float, samples: tuple[int, int]
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Vertices and points (N, 3) float32 [m] evenly drawn on those faces of each part that are `wanted`, of
    all parts' faces one after another; and the face (M,) of its part that each drawn point is on."""
    # All drawn at once: hundreds of parts, and a mesh object each would take longer than the drawing.
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    faces = np.concatenate([faces + start for (_, faces), start in zip(parts, starts)])
    first_face = np.cumsum([0, *(len(faces) for _, faces in parts)])
    of_face = np.repeat(np.arange(len(parts)), np.diff(first_face))
    whole = trimesh.Trimesh(np.concatenate([vertices for vertices, _ in parts]), faces, process=False)
    areas = whole.area_faces * wanted
    area = np.bincount(of_face, areas, len(parts))
    count = np.clip(area / spacing**2, *samples)
    weight = areas * (count / np.maximum(area, 1e-18))[of_face]
    drawn, on_face = trimesh.sample.sample_surface(whole, int(count.sum()), face_weight=weight, seed=0)
    order = np.argsort(of_face[on_face], kind="stable")
    ends = np.searchsorted(of_face[on_face][order], np.arange(1, len(parts)))
    return [
        (np.concatenate([vertices, points]).astype(np.float32), own - first_face[number])
        for number, ((vertices, _), points, own) in enumerate(
            zip(parts, np.split(drawn[order], ends), np.split(on_face[order], ends))
        )
    ]


def _along_edges(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Points (N, 3) float32 [m] within the edges of a part, which stick out most, EDGE_SPACING apart."""
    edges = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    begin, end = vertices[edges[edges[:, 0] < edges[:, 1]]].transpose(1, 0, 2)  # each is there twice
    count = (np.linalg.norm(end - begin, axis=1) / EDGE_SPACING).astype(int)
    which = np.repeat(np.arange(len(count)), count)
    number = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
    share = ((number + 1) / (count[which] + 1))[:, None]
    return (begin[which] + share * (end[which] - begin[which])).astype(np.float32)
