"""A stored result with known shapes, in a world that is turned and shifted, for the tests of exports."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import trimesh
from conftest import look_at
from scipy.spatial.transform import Rotation

from mapping import ContraMap, MapConfig
from perception.camera import Camera, transform
from perception.frame import Frame
from perception.frame_io import save_frame
from reconstruction.export.export_scene import ExportScene
from reconstruction.export.virtual_views import render
from reconstruction.files.result_folder import StoredObject, StoredResult
from reconstruction.solid import Solid

MUG_RADIUS, MUG_HEIGHT, WALL = 0.045, 0.10, 0.006  # [m]


@cache
def mug() -> trimesh.Trimesh:
    """An open mug with a block for a handle, standing on z = 0, opening upwards; no symmetry but one
    plane."""
    outer = trimesh.creation.cylinder(MUG_RADIUS, MUG_HEIGHT, sections=32)
    inner = trimesh.creation.cylinder(MUG_RADIUS - WALL, MUG_HEIGHT, sections=32)
    handle = trimesh.creation.box((0.03, 0.012, 0.06))
    handle.apply_translation([MUG_RADIUS + 0.012, 0, 0])
    inner.apply_translation([0, 0, WALL])
    mesh = trimesh.boolean.difference([trimesh.boolean.union([outer, handle]), inner])
    mesh.apply_translation([0, 0, MUG_HEIGHT / 2])
    return mesh


@cache
def bracket() -> trimesh.Trimesh:
    """Three arms of different lengths: no symmetry at all; standing on z = 0."""
    arms = [
        trimesh.creation.box(size) for size in ((0.10, 0.03, 0.03), (0.03, 0.07, 0.03), (0.03, 0.03, 0.05))
    ]
    for arm in arms:
        arm.apply_translation(np.array(arm.extents) / 2)
    return trimesh.boolean.union(arms)


@dataclass(frozen=True)
class PlannerScene:
    """A result, and label -> the vertices (V, 3) [m, world frame] every consumer has to find."""

    result: StoredResult
    meshes: dict[int, trimesh.Trimesh]

    def scene(self, **settings) -> ExportScene:
        from reconstruction.export.export_scene import ExportConfig

        return ExportScene(self.result, ExportConfig(**settings))


def planner_scene(folder: Path) -> PlannerScene:
    """A mug and a bracket on a table, in a world whose z axis is not up; the frame is below folder/frame."""
    T_world_table = np.eye(4)
    T_world_table[:3, :3] = Rotation.from_euler("xyz", [0.5, -0.3, 1.1]).as_matrix()
    T_world_table[:3, 3] = [0.4, -0.7, 0.9]
    objects, meshes = [], {}
    for label, (name, mesh, x, yaw) in enumerate(
        (("mug", mug(), -0.08, 0.7), ("bracket", bracket(), 0.07, -1.9)), start=1
    ):
        T_table_body = np.eye(4)
        T_table_body[:3, :3] = Rotation.from_euler("z", yaw).as_matrix()
        T_table_body[:3, 3] = [x, 0.02 * label, 0]
        middle = np.eye(4)
        middle[:3, 3] = mesh.bounds.mean(0)
        T = T_world_table @ T_table_body
        meshes[label] = trimesh.Trimesh(transform(T, np.asarray(mesh.vertices)), mesh.faces, process=False)
        unsure = np.linspace(0, 1, len(mesh.vertices)).astype(np.float32)
        objects.append(
            StoredObject(label, name, meshes[label], unsure, T @ middle, mesh.extents.copy(), folder, label)
        )
    K = np.array([[170.0, 0, 79.5], [0, 170.0, 59.5], [0, 0, 1]])
    camera = Camera(K, 160, 120, T_world_table @ look_at((-0.35, 0.0, 0.4), (0.0, 0.0, 0.04)))
    slab = trimesh.creation.box((1.0, 1.0, 0.02))
    slab.apply_translation([0, 0, -0.01])
    slab.apply_transform(T_world_table)
    depth, index = render([*meshes.values(), slab], camera)
    labels = np.array([1, 2, 0, 0], np.uint16)[index]
    depth = np.where(depth > 0, depth, np.nan)
    rgb = np.repeat(labels[..., None].astype(np.uint8) * 100, 3, axis=2)
    frame = Frame(depth, camera, rgb, labels, {1: "mug", 2: "bracket"})
    save_frame(frame, folder / "frame", 1e-4)
    _small_map(objects, T_world_table).save(folder / "map.npz")
    scene = {"T_world_table": T_world_table.tolist(), "support_plane": {"inlier_ratio": 1.0}}
    return PlannerScene(StoredResult(folder, scene, tuple(objects)), meshes)


def _small_map(objects: list[StoredObject], T_world_table: np.ndarray) -> ContraMap:
    """A map of the table frame: the two objects, empty space, and "uncertain" beyond y = 0.08 m."""
    axes = [np.arange(-0.2, 0.21, 0.02), np.arange(-0.2, 0.21, 0.02), np.arange(0.01, 0.2, 0.02)]
    X = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3).astype(np.float32)
    y = np.where(X[:, 1] > 0.08, 3, 0)
    for item in objects:
        y[Solid(item.mesh).inside(transform(T_world_table, X.astype(float)))] = item.label
    return ContraMap(MapConfig(gamma=2000.0)).fit(X, y)


def pose_error(found: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """Largest distance [m] of found vertices (V, 3) from the true ones, and the angle [deg] between the
    sets."""
    assert found.shape == true.shape
    rotation, _ = Rotation.align_vectors(found - found.mean(0), true - true.mean(0))
    return float(np.linalg.norm(found - true, axis=1).max()), float(np.degrees(rotation.magnitude()))


def assert_same_place(found: np.ndarray, true: np.ndarray) -> None:
    """Within 1 mm and 0.1 degrees, vertex by vertex."""
    distance, angle = pose_error(np.asarray(found, float), np.asarray(true, float))
    assert distance < 1e-3
    assert angle < 0.1


def export_folder(planned: PlannerScene, out: Path):
    """A function from a format's name to its folder, which is written when first asked for."""
    from reconstruction.export.formats import export

    scene = planned.scene()

    def folder(name: str) -> Path:
        if not (out / name).exists():
            export(scene, [name], out)
        return out / name

    return folder


def rigid(position, xyzw) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(xyzw).as_matrix()
    T[:3, 3] = position
    return T


def wxyz(values) -> list[float]:
    w, x, y, z = values
    return [x, y, z, w]


def key(label: int) -> str:
    return {1: "1_mug", 2: "2_bracket"}[label]
