"""Convex parts of different objects kept apart: where two overlap, both end at a plane between them.

Surfaces that were guessed may reach into a neighbour by millimetres; physics would throw both away. Knows
convex meshes in one frame; knows nothing of formats.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import trimesh

from perception.camera import invert_rigid
from reconstruction.export.export_object import moved
from reconstruction.export.hulls import Hull, convex_hull

Parts = tuple[Hull, ...]
THICK = 0.004
"""What is at least this thick gives as much as anything else [m]."""


def kept_apart(objects: Mapping[int, Parts], gap: float) -> dict[int, Parts]:
    """Label -> convex parts [m] of objects in one frame, none nearer than `gap` [m] to one of another.

    An object always keeps at least one part: one that would lose all stays as it was.
    """
    found = {label: list(parts) for label, parts in objects.items()}
    labels = list(found)
    limits = {label: boxes(parts) for label, parts in objects.items()}
    for number, first in enumerate(labels):
        for second in labels[number + 1 :]:
            _separate(found[first], found[second], limits[first], limits[second], gap)
    return {
        label: tuple(part for part in found[label] if part is not None) or objects[label] for label in found
    }


def meshes_beside(
    meshes: Sequence[trimesh.Trimesh], poses: Sequence[np.ndarray]
) -> list[list[trimesh.Trimesh]]:
    """For each of meshes with poses (4, 4) those others whose boxes meet its own, in its frame."""
    around = boxes([moved(mesh, pose) for mesh, pose in zip(meshes, poses)])
    meet = np.all((around[:, None, 0] < around[:, 1]) & (around[:, 0] < around[:, None, 1]), axis=-1)
    return [
        [moved(meshes[j], invert_rigid(pose) @ poses[j]) for j in np.flatnonzero(meet[i]).tolist() if j != i]
        for i, pose in enumerate(poses)
    ]


def _separate(first: list, second: list, one: np.ndarray, two: np.ndarray, gap: float) -> None:
    """Cut the parts of two objects where they are nearer than `gap` [m], in place; what is lost whole becomes
    None.

    one, two: the parts' boxes (N, 2, 3) before any was cut.
    """
    # Hundreds of parts each: only pairs whose boxes meet are looked at, and cutting makes boxes no larger.
    meet = ((one[:, None, 0] < two[:, 1] + gap) & (two[:, 0] < one[:, None, 1] + gap)).all(-1)
    for i, j in np.argwhere(meet):
        if first[i] is None or second[j] is None:
            continue
        plane = overlap(first[i], second[j], gap)
        if plane is None:
            continue
        normal, low, high = plane
        cut = high - low + gap
        thick = high - (first[i].vertices @ normal).min(), (second[j].vertices @ normal).max() - low
        share = share_of_thicker(*thick)
        first[i] = below(first[i], normal, high - share * cut)
        second[j] = below(second[j], -normal, -low - (1 - share) * cut)


def share_of_thicker(one: float, two: float) -> float:
    """Share of a cut that the first of two things takes, by their thickness [m]: what is thin gives less."""
    one, two = min(one, THICK), min(two, THICK)
    return one**2 / (one**2 + two**2)


def boxes(parts: Sequence[Hull | trimesh.Trimesh]) -> np.ndarray:
    """(N, 2, 3) [m]: corners low, high of each part."""
    return np.array([part.bounds for part in parts], float).reshape(-1, 2, 3)


def overlap(first: Hull, second: Hull, gap: float) -> tuple[np.ndarray, float, float] | None:
    """A direction n (3,) along which two convex parts overlap least, of their faces' normals: the second
    begins at n x = low and the first ends at n x = high > low - gap [m]. None when one of them parts the two
    by `gap`."""
    (low, high), (other_low, other_high) = first.bounds, second.bounds
    if (low >= other_high + gap).any() or (other_low >= high + gap).any():
        return None
    a, b = first.vertices, second.vertices
    normals = np.concatenate([first.face_normals, -second.face_normals, np.eye(3), -np.eye(3)])
    normals = normals[np.einsum("ij,ij->i", normals, normals) > 0.5]  # slivers of hulls have none
    ends, begins = (normals @ a.T).max(1), (normals @ b.T).min(1)
    depth = ends - begins
    best = int(depth.argmin())
    if depth[best] <= -gap + 1e-9:
        return None
    return normals[best], float(begins[best]), float(ends[best])


def below(part: Hull, normal: np.ndarray, height: float) -> Hull | None:
    """What of a convex part lies where normal x <= height [m]; None when that is nothing or a splinter."""
    vertices = part.vertices
    above = vertices @ normal - height
    if (above <= 0).all():
        return part
    if (above >= 0).all():
        return None
    edges = part.edges_unique
    ends = above[edges]
    crossed = (ends[:, 0] < 0) != (ends[:, 1] < 0)
    share = (ends[crossed, 0] / (ends[crossed, 0] - ends[crossed, 1]))[:, None]
    a, b = vertices[edges[crossed, 0]], vertices[edges[crossed, 1]]
    return convex_hull(np.concatenate([vertices[above <= 0], a + share * (b - a)]))
