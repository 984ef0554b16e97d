"""Labelled meshes to labelled clouds: sampled by area, or seen by virtual depth cameras.

Knows triangles and their classes; must not know maps.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mapping.errors import DataError
from perception.labelled_cloud import LabelledCloud, checked_cloud
from perception.ray_casting import ray_scene

CLEARANCE = 0.4
"""Virtual cameras stand at least this far from any surface [m]."""


@dataclass(frozen=True)
class LabelledMesh:
    """vertices: (V, 3) [m]; faces: (F, 3); labels: (F,) index into names."""

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    labels: np.ndarray
    names: tuple[str, ...]


def read_mesh(path: Path) -> LabelledMesh:
    """An .npz with vertices (V, 3) [m], faces (F, 3), face_object (F,) and object_class, a name an object.

    Raises DataError when something is missing or does not fit.
    """
    from mapping.guarded_files import read_npz

    arrays = read_npz(path)
    for name in ("vertices", "faces", "face_object", "object_class"):
        if name not in arrays:
            raise DataError(f"{path}: no array {name!r}, found {', '.join(sorted(arrays))}")
    vertices, faces, thing = (arrays[name] for name in ("vertices", "faces", "face_object"))
    names, of_object = np.unique(arrays["object_class"].astype(str), return_inverse=True)
    if faces.ndim != 2 or faces.shape[1] != 3 or thing.shape != (len(faces),) or not len(faces):
        raise DataError(f"{path}: wanted faces (F, 3) and face_object (F,), got {faces.shape}, {thing.shape}")
    if faces.min() < 0 or faces.max() >= len(vertices) or thing.min() < 0 or thing.max() >= len(of_object):
        raise DataError(f"{path}: faces or face_object name vertices or objects that are not there")
    return LabelledMesh(path.stem, vertices.astype(np.float64), faces, of_object[thing], tuple(names))


def sample_by_area(mesh: LabelledMesh, count: int, rng: np.random.Generator) -> LabelledCloud:
    """`count` points spread evenly over the mesh's surface."""
    corners = mesh.vertices[mesh.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    if not area.sum() > 0:
        raise DataError(f"{mesh.name}: the mesh has no area")
    face = rng.choice(len(area), count, p=area / area.sum())
    u, v = rng.random((2, count))
    over = u + v > 1
    u[over], v[over] = 1 - u[over], 1 - v[over]
    a, b, c = corners[face].swapaxes(0, 1)
    points = a + u[:, None] * (b - a) + v[:, None] * (c - a)
    return checked_cloud(mesh.name, points, mesh.labels[face], mesh.names)


def seen_from(mesh: LabelledMesh, origin: np.ndarray, rays: int, rng: np.random.Generator) -> LabelledCloud:
    """What a camera that looks all around sees from `origin` (3,) [m]: where rays first meet the mesh."""
    import open3d

    directions = rng.normal(size=(rays, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    scene = _scene(mesh)
    cast = np.concatenate([np.broadcast_to(origin, directions.shape), directions], 1).astype(np.float32)
    answer = scene.cast_rays(open3d.core.Tensor.from_numpy(cast))
    distance = answer["t_hit"].numpy()
    hit = np.isfinite(distance)
    if not hit.any():
        raise DataError(f"{mesh.name}: no ray from {np.round(origin, 2).tolist()} meets the mesh")
    face = answer["primitive_ids"].numpy()[hit].astype(np.int64)
    points = origin + distance[hit, None] * directions[hit]
    return checked_cloud(mesh.name, points, mesh.labels[face], mesh.names, np.asarray(origin, float))


def viewpoints(mesh: LabelledMesh, count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, 3) places [m] inside the mesh's bounding box with CLEARANCE around them.

    Raises DataError when there are none.
    """
    import open3d

    low, high = mesh.vertices.min(0), mesh.vertices.max(0)
    places = rng.uniform(low, high, (200 * count, 3)).astype(np.float32)
    distance = _scene(mesh).compute_distance(open3d.core.Tensor.from_numpy(places)).numpy()
    free = places[distance > CLEARANCE]
    if len(free) < count:
        raise DataError(f"{mesh.name}: no room for {count} cameras {CLEARANCE} m from every surface")
    return free[:count].astype(np.float64)


def _scene(mesh: LabelledMesh) -> Any:
    return ray_scene([(mesh.vertices, mesh.faces)])
