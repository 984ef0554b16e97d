"""Contact-GraspNet: npz files as its loader reads them, of what was measured and with hidden surfaces
added."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from perception.camera import invert_rigid, transform
from reconstruction.export.export_object import moved
from reconstruction.export.export_scene import ExportScene
from reconstruction.export.virtual_views import render

DENSITY = 4e5
"""Points per square metre drawn on meshes: 1.6 mm apart."""
STATEMENT = {
    "frame": "camera (OpenCV axes: x right, y down, z forward)",
    "unit": "m; 0 = no depth",
    "quaternion": "none; T_world_camera is a 4x4 matrix",
    "raw.npz": "depth, K, segmap, rgb as measured; `contramap map` reads it too",
    "completed.npz": "the same image with the objects' meshes in it: their pixels filled and free of noise",
    "completed_cloud.npz": "xyz: measured points, and points on the objects' whole surfaces, hidden ones as "
    "well; "
    "labels: instance of each point, 0 = none; hidden: whether the camera saw the point",
}


def write(scene: ExportScene, folder: Path) -> None:
    """raw.npz, completed.npz and completed_cloud.npz."""
    frame = scene.frame
    depth = np.nan_to_num(frame.depth)
    labels = frame.labels if frame.labels is not None else np.zeros(depth.shape, np.uint16)
    rgb = frame.rgb if frame.rgb is not None else np.full((*depth.shape, 3), 128, np.uint8)
    same = {"K": frame.camera.K, "rgb": rgb, "T_world_camera": frame.camera.T_world_camera}
    _save(folder / "raw.npz", depth=depth, segmap=labels, **same)

    meshes = [moved(item.mesh, item.T_world_object) for item in scene.objects]
    drawn, index = render(meshes, frame.camera)
    mine = np.array([*(item.label for item in scene.objects), 0], np.uint16)[index]
    # A mesh counts where its object was labelled, or where nothing was measured: masks and real occluders
    # win.
    fits = (index >= 0) & ((mine == labels) | (depth == 0))
    _save(
        folder / "completed.npz",
        depth=np.where(fits, drawn, depth),
        segmap=np.where(fits, mine, labels),
        **same,
    )
    _save(folder / "completed_cloud.npz", **_cloud(scene, depth, labels, drawn))


def _cloud(
    scene: ExportScene, depth: np.ndarray, labels: np.ndarray, drawn: np.ndarray
) -> dict[str, np.ndarray]:
    import trimesh

    camera = scene.frame.camera
    measured = depth > 0
    points = [camera.back_project(depth)[measured]]
    instance, hidden = [labels[measured]], [np.zeros(int(measured.sum()), bool)]
    for item in scene.objects:
        count = int(np.clip(item.mesh.area * DENSITY, 100, 20_000))
        surface, _ = trimesh.sample.sample_surface(item.mesh, count, seed=0)
        T_camera_object = invert_rigid(camera.T_world_camera) @ item.T_world_object
        local = transform(T_camera_object, np.asarray(surface, float))
        points.append(local.astype(np.float32))
        instance.append(np.full(count, item.label, np.uint16))
        pixel, z = camera.project(local)
        u, v = np.rint(pixel).astype(int).T
        within = (z > 0) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        behind = np.ones(count, bool)
        behind[within] = z[within] > drawn[v[within], u[within]] + 0.003
        hidden.append(behind)
    return {
        "xyz": np.concatenate(points),
        "labels": np.concatenate(instance),
        "hidden": np.concatenate(hidden),
        "T_world_camera": camera.T_world_camera,
    }


def _save(path: Path, **arrays: np.ndarray) -> None:
    with path.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)
