"""What a planner is told of a scene: surfaces from one of several methods, and how unsure space is.

Knows frames, methods of the evaluation and true poses; knows nothing of hands.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from perception.camera import invert_rigid, transform
from perception.frame import Frame
from perception.observing import observe
from perception.space import Space
from sim_scenes.tabletop import PlacedObject
from tools.evaluation.fitted_map import View
from tools.evaluation.methods import method

SOURCES = ("raw", "tsdf", "vprism", "contramap", "truth")
"""Where shapes can come from."""

Doubt = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Points (N, 3) [m, world] -> probability that an object is there (N,), p(uncertain) (N,)."""


@dataclass(frozen=True)
class Cloud:
    """Surface points (N, 3) [m, world] with unit normals (N, 3) outwards."""

    points: np.ndarray
    normals: np.ndarray


@dataclass(frozen=True)
class Shapes:
    """meshes: label -> surface [m, world]; clouds: the same where all that is known is what was measured;
    doubt: how sure space is, where the method says so. The table is at z = 0."""

    frame: Frame
    meshes: dict[int, trimesh.Trimesh]
    clouds: dict[int, Cloud]
    doubt: Doubt | None = None


def shapes_of(source: str, frame: Frame, placed: Sequence[PlacedObject], rng: np.random.Generator) -> Shapes:
    """The shapes of a frame's objects by one of SOURCES; label k is the k-th of `placed`, which only "truth"
    looks at. Raises FrameError when the frame shows no usable object."""
    if source == "truth":
        return Shapes(frame, {k: _placed_mesh(item) for k, item in enumerate(placed, start=1)}, {})
    if source == "raw":
        return Shapes(frame, {}, _clouds(frame))
    observation = observe(frame)
    view = View(frame, observation, Space.of(observation))
    fitted = method(source).fit(view, rng)
    T_world_table = frame.camera.T_world_camera @ invert_rigid(observation.T_table_camera)
    meshes = {}
    for item, surface in zip(observation.objects, fitted.meshes(view)):
        if surface is not None:
            vertices = transform(T_world_table, np.asarray(surface.mesh.vertices, float))
            meshes[item.label] = trimesh.Trimesh(vertices, surface.mesh.faces, process=False)
    T_table_world = invert_rigid(T_world_table)

    def doubt(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        probability, uncertainty = fitted.predict(transform(T_table_world, points).astype(np.float32))
        return 1 - probability[:, 0], uncertainty

    return Shapes(frame, meshes, {}, doubt)


def _placed_mesh(item: PlacedObject) -> trimesh.Trimesh:
    mesh = item.model.mesh
    vertices = transform(item.T_world_object, np.asarray(mesh.vertices, float))
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


def _clouds(frame: Frame) -> dict[int, Cloud]:
    """What was measured of each label, with normals from neighbouring pixels of the same label."""
    assert frame.labels is not None
    depth, T = np.nan_to_num(frame.depth), frame.camera.T_world_camera
    grid = transform(T, (frame.camera.rays * depth[..., None]).reshape(-1, 3)).reshape(*depth.shape, 3)
    across = grid[1:-1, 2:] - grid[1:-1, :-2]
    down = grid[2:, 1:-1] - grid[:-2, 1:-1]
    normals = np.zeros_like(grid)
    normals[1:-1, 1:-1] = np.cross(down, across)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    away = ((grid - T[:3, 3]) * normals).sum(-1) > 0
    normals[away] *= -1
    found = {}
    for label in np.unique(frame.labels[frame.labels > 0]):
        mask = (frame.labels == label) & (depth > 0)
        found[int(label)] = Cloud(grid[mask], normals[mask])
    return found
