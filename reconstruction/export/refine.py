"""Convex parts that bulge out of their mesh cut in two until they do not.

Knows which parts bulge and where; whoever cuts them knows how.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import trimesh

from reconstruction.export.cutting import Surface
from reconstruction.export.hulls import as_mesh
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
    parts: Sequence[Surface],
    solid: Solid,
    halve: Callable[[Sequence[int], np.ndarray], list[list[Surface]]],
    limit: float,
) -> list[trimesh.Trimesh]:
    """Convex parts of a solid [m], halved until none bulges out of it by more than `limit` [m] where that can
    be had.

    halve: as Cutter.halve, of a cutter that has these parts now.
    """
    todo = list(parts)
    done: list[Surface] = []
    for _ in range(ROUNDS):
        if not todo or len(done) + len(todo) > MOST_PARTS:
            break
        worst = bulges(todo, solid)
        wanted = [number for number, (depth, _) in enumerate(worst) if depth > limit]
        places = np.array([worst[number][1] for number in wanted], float).reshape(-1, 3)
        halves = halve(wanted, places) if wanted else []
        whole = {number for number, pair in zip(wanted, halves) if not pair}
        done += [part for number, part in enumerate(todo) if number in whole or number not in wanted]
        todo = [half for pair in halves for half in pair]
    return [as_mesh(part) for part in done + todo]


def bulges(parts: Sequence[Surface], solid: Solid) -> list[tuple[float, np.ndarray]]:
    """How far each convex part reaches out of the solid at most [m], and where (3,)."""
    clouds = _points_on(parts)
    everything = np.concatenate(clouds)
    outside = ~solid.inside(everything)
    depth = np.zeros(len(everything))
    depth[outside] = solid.distance(everything[outside])
    found = []
    for cloud, own in zip(clouds, np.split(depth, np.cumsum([len(cloud) for cloud in clouds])[:-1])):
        found.append((float(own.max()), cloud[own.argmax()]))
    return found


def _points_on(parts: Sequence[Surface]) -> list[np.ndarray]:
    """Vertices and evenly drawn surface points (N, 3) float32 [m] of each part."""
    # All drawn at once: hundreds of parts, and a mesh object each would take longer than the drawing.
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    faces = np.concatenate([faces + start for (_, faces), start in zip(parts, starts)])
    of_face = np.repeat(np.arange(len(parts)), [len(faces) for _, faces in parts])
    whole = trimesh.Trimesh(np.concatenate([vertices for vertices, _ in parts]), faces, process=False)
    area = np.bincount(of_face, whole.area_faces)
    wanted = np.clip(area / SPACING**2, *SAMPLES)
    weight = whole.area_faces * (wanted / area)[of_face]
    drawn, on_face = trimesh.sample.sample_surface(whole, int(wanted.sum()), face_weight=weight, seed=0)
    order = np.argsort(of_face[on_face], kind="stable")
    ends = np.searchsorted(of_face[on_face][order], np.arange(1, len(parts)))
    return [
        np.concatenate([vertices, points]).astype(np.float32)
        for (vertices, _), points in zip(parts, np.split(drawn[order], ends))
    ]
