"""Depth images of meshes from any camera, and truncated distance fields of depth images.

Knows cameras, meshes and voxels; knows nothing of results or grasp networks.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import trimesh

from perception.camera import Camera, invert_rigid
from perception.ray_casting import ray_scene, tensor

FAR = 5.0
"""Depth images are cut here [m]."""


def render(meshes: Sequence[trimesh.Trimesh], camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Depth (H, W) float32 [m], 0 where nothing is, and the index of the mesh that is seen (H, W), -1 for
    none.

    meshes: in the world frame of the camera's pose.
    """
    # In the camera's frame: single precision is enough however far away the world's origin is.
    R, t = np.split(invert_rigid(camera.T_world_camera)[:3], [3], axis=1)
    scene = ray_scene((np.asarray(mesh.vertices) @ R.T + t[:, 0], mesh.faces) for mesh in meshes)
    rays = np.concatenate([np.zeros_like(camera.rays), camera.rays], axis=-1)
    hits = scene.cast_rays(tensor(rays))
    # Rays have z = 1, so where a ray ends is the depth.
    depth = hits["t_hit"].numpy()
    seen = np.isfinite(depth)
    index = np.where(seen, hits["geometry_ids"].numpy().astype(np.int64), -1)
    return np.where(seen, depth, 0).astype(np.float32), index


def truncated_distances(
    views: Sequence[tuple[np.ndarray, Camera]], T_world_cube: np.ndarray, side: float, voxels: int
) -> np.ndarray:
    """TSDF (voxels,)*3 float32 of depth images (H, W) [m] with 0 where missing, in a cube of `side` [m].

    (tsdf + 1) / 2 in voxels that were observed near a surface (above 0.5 outside, below inside), 0 in all
    others; truncated at four voxels. Axis i of the array is axis i of the cube, whose corner is the origin of
    T_world_cube.
    """
    from importlib import import_module

    # Typed as Any: open3d's stubs do not know that its images take arrays.
    open3d: Any = import_module("open3d")
    size = side / voxels
    volume = open3d.pipelines.integration.UniformTSDFVolume(
        length=side,
        resolution=voxels,
        sdf_trunc=4 * size,
        color_type=open3d.pipelines.integration.TSDFVolumeColorType.NoColor,
    )
    for depth, camera in views:
        image = open3d.geometry.RGBDImage.create_from_color_and_depth(
            open3d.geometry.Image(np.zeros((*depth.shape, 3), np.uint8)),
            open3d.geometry.Image(np.ascontiguousarray(depth, np.float32)),
            depth_scale=1.0,
            depth_trunc=FAR,
            convert_rgb_to_intensity=False,
        )
        K = camera.K
        pinhole = open3d.camera.PinholeCameraIntrinsic(
            camera.width, camera.height, K[0, 0], K[1, 1], K[0, 2], K[1, 2]
        )
        volume.integrate(image, pinhole, invert_rigid(camera.T_world_camera) @ T_world_cube)
    cloud = volume.extract_voxel_point_cloud()
    grid = np.zeros((voxels,) * 3, np.float32)
    cells = np.floor(np.asarray(cloud.points) / size).astype(int)
    grid[tuple(cells.T)] = np.asarray(cloud.colors)[:, 0]
    return grid


def ring_of_cameras(
    T_world_table: np.ndarray, target: np.ndarray, distance: float, count: int, size: tuple[int, int]
) -> list[Camera]:
    """Cameras 45 degrees above the table all around a target (3,) [m, table frame], looking at it.

    size: image width and height [px].
    """
    focal = 0.9 * size[0]
    K = np.array([[focal, 0, size[0] / 2 - 0.5], [0, focal, size[1] / 2 - 0.5], [0, 0, 1]])
    cameras = []
    for turn in 2 * np.pi * np.arange(count) / count:
        away = np.array([np.cos(turn), np.sin(turn), 1.0]) / np.sqrt(2)
        T = np.eye(4)
        right = np.array([-np.sin(turn), np.cos(turn), 0.0])
        T[:3, :3] = np.stack([right, np.cross(-away, right), -away], axis=1)
        T[:3, 3] = target + distance * away
        cameras.append(Camera(K, *size, T_world_table @ T))
    return cameras
