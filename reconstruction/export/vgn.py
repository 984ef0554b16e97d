"""VGN and GIGA: a 40^3 TSDF of a 0.3 m cube around each object, as measured and completed by all meshes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from perception.camera import invert_rigid, transform
from reconstruction.export.export_object import ExportObject, moved
from reconstruction.export.export_scene import ExportScene
from reconstruction.export.virtual_views import render, ring_of_cameras, truncated_distances

SIDE, VOXELS = 0.30, 40
"""The cube [m], and voxels along it."""
FLOOR = 0.05
"""The support lies this far above the cube's floor [m]."""
VIEWS, DISTANCE, IMAGE = 6, 0.5, (160, 120)
"""Views of the meshes that make the completed field, as the network's training scenes were seen."""
STATEMENT = {
    "frame": "axes of the cube, z along the support's normal; T_world_cube leads to the world frame of the "
    "result",
    "unit": "m; a voxel is 7.5 mm; values are (tsdf + 1) / 2 near observed surfaces (truncated at 4 voxels, "
    "above "
    "0.5 outside) and 0 elsewhere",
    "quaternion": "none; T_world_cube is a 4x4 matrix (the network answers with x y z w)",
}


def write(scene: ExportScene, folder: Path) -> None:
    """<key>.npz: raw and completed (1, 40, 40, 40) float32, T_world_cube, voxel_size, label."""
    frame = scene.frame
    measured = [(np.nan_to_num(frame.depth), frame.camera)]
    meshes = [moved(item.mesh, item.T_world_object) for item in scene.obstacles]
    for item in scene.objects:
        T_world_cube = cube_around(item, scene)
        middle = invert_rigid(scene.T_world_table) @ T_world_cube @ [SIDE / 2, SIDE / 2, FLOOR, 1.0]
        whole = completed(meshes, scene.T_world_table, middle[:3], T_world_cube)
        with (folder / f"{item.key}.npz").open("wb") as file:
            np.savez_compressed(
                file,
                allow_pickle=False,
                raw=truncated_distances(measured, T_world_cube, SIDE, VOXELS)[None],
                completed=whole[None],
                T_world_cube=T_world_cube,
                voxel_size=np.float64(SIDE / VOXELS),
                label=np.int64(item.label),
            )


def cube_around(item: ExportObject, scene: ExportScene) -> np.ndarray:
    """T_world_cube (4, 4): the corner of the cube that holds an object in its middle, axes of the table
    frame.

    The support is 5 cm above the cube's floor; without one, the object's lowest point is.
    """
    T_table_world = invert_rigid(scene.T_world_table)
    points = transform(T_table_world, np.asarray(moved(item.mesh, item.T_world_object).vertices))
    low, high = points.min(0), points.max(0)
    T = np.eye(4)
    T[:2, 3] = (low[:2] + high[:2]) / 2 - SIDE / 2
    T[2, 3] = (0.0 if scene.support_found else low[2]) - FLOOR
    return scene.T_world_table @ T


def completed(
    meshes: list[trimesh.Trimesh], T_world_table: np.ndarray, middle: np.ndarray, T_world_cube: np.ndarray
) -> np.ndarray:
    """TSDF (40, 40, 40) of meshes [m, world frame] and the support, seen from all around.

    middle: (3,) point of the support below the cube's middle [m, table frame].
    """
    slab = trimesh.creation.box((2.0, 2.0, 0.02))
    slab.apply_translation([middle[0], middle[1], middle[2] - 0.01])
    slab.apply_transform(T_world_table)
    target = middle + np.array([0, 0, SIDE / 4])
    cameras = ring_of_cameras(T_world_table, target, DISTANCE, VIEWS, IMAGE)
    views = [(render([*meshes, slab], camera)[0], camera) for camera in cameras]
    return truncated_distances(views, T_world_cube, SIDE, VOXELS)
