"""GPD: point clouds (PCD) of the scene and of each object, as measured and completed, and the camera's
position."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from mapping.errors import DataError
from perception.camera import transform
from reconstruction.export.export_object import moved
from reconstruction.export.export_scene import ExportScene

COARSEST = 1e-4
"""Largest step between numbers of single precision that a point may be rounded by [m]."""
DENSITY = 4e5
"""Points per square metre drawn on meshes: 1.6 mm apart."""
STATEMENT = {
    "frame": "world frame of the result",
    "unit": "m",
    "quaternion": "w x y z in the VIEWPOINT line of each PCD, which is the camera's pose",
    "camera": "camera_position in camera.cfg [m]; GPD's configuration files take this line",
}


def write(scene: ExportScene, folder: Path) -> None:
    """scene.pcd, target_<key>.pcd, completed_<key>.pcd and camera.cfg.

    Raises DataError when the world frame's origin is too far away for such files.
    """
    _check_near([item.T_world_object for item in scene.objects])
    frame = scene.frame
    T = frame.camera.T_world_camera
    measured = np.isfinite(frame.depth)
    world = transform(T, frame.camera.back_project(frame.depth)[measured].astype(float))
    labels = frame.labels[measured] if frame.labels is not None else np.zeros(len(world), np.uint16)
    write_pcd(folder / "scene.pcd", world, T)
    for item in scene.objects:
        write_pcd(folder / f"target_{item.key}.pcd", world[labels == item.label], T)
        mesh = moved(item.mesh, item.T_world_object)
        points, _ = trimesh.sample.sample_surface(mesh, max(100, int(mesh.area * DENSITY)), seed=0)
        write_pcd(folder / f"completed_{item.key}.pcd", np.asarray(points), T)
    x, y, z = T[:3, 3]
    (folder / "camera.cfg").write_text(
        f"# world frame, m\ncamera_position = {x:.6f} {y:.6f} {z:.6f}\n", encoding="utf-8"
    )


def _check_near(poses: list[np.ndarray]) -> None:
    farthest = max((float(np.abs(T[:3, 3]).max()) for T in poses), default=0.0)
    step = float(np.spacing(np.float32(farthest)))
    if step > COARSEST:
        raise DataError(
            f"gpd: objects are {farthest / 1000:.0f} km from the world frame's origin, and its point clouds "
            f"hold single precision, {1000 * step:.1f} mm there; map the frame with T_world_camera near it"
        )


def write_pcd(path: Path, points: np.ndarray, T_world_camera: np.ndarray) -> None:
    """A binary PCD of points (N, 3) [m] seen from a camera."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(T_world_camera[:3, :3]).as_quat(canonical=True)
    viewpoint = " ".join(f"{value:.9g}" for value in (*T_world_camera[:3, 3], w, x, y, z))
    header = (
        "# .PCD v0.7 - contramap, world frame, m\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT "
        "1 1 1\n"
        f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT {viewpoint}\nPOINTS {len(points)}\nDATA binary\n"
    )
    path.write_bytes(header.encode() + np.ascontiguousarray(points, "<f4").tobytes())
