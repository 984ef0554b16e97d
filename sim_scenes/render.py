"""Draws a tabletop scene by ray casting: metric depth, instance labels and a shaded colour image.

Runs anywhere open3d runs, without a display or OpenGL. World: z up, table top at z = 0, in a room.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from perception.camera import Camera, look_at
from perception.ray_casting import ray_scene, tensor
from sim_scenes.objects.object_model import ObjectModel
from sim_scenes.shading import Surface, cast_shadows, shade
from sim_scenes.surroundings import Surroundings
from sim_scenes.tabletop import PlacedObject

FINE = 3
"""Rays per pixel along each axis where the image varies."""
FINE_CONTRAST = 0.12
"""Difference in brightness (0..3) to a neighbouring pixel above which a pixel gets more rays."""


@dataclass(frozen=True)
class CameraConfig:
    """The simulated RGB-D camera and where it may stand."""

    width: int = 640
    """Image width [px]."""
    height: int = 480
    """Image height [px]."""
    focal_px: float = 605.0
    """Focal length [px]."""
    distance_m: tuple[float, float] = (0.6, 1.0)
    """Nearest and farthest distance from the table's centre."""
    elevation_deg: tuple[float, float] = (30.0, 60.0)
    """Lowest and highest viewing angle above the table."""


def random_cameras(
    views: int, target: np.ndarray, rng: np.random.Generator, config: CameraConfig | None = None
) -> list[Camera]:
    """Cameras around `target` (3,) [m]: the first anywhere, the others spread evenly around from it."""
    config = config or CameraConfig()
    first = rng.uniform(0, 2 * np.pi)
    K = np.array(
        [
            [config.focal_px, 0, (config.width - 1) / 2],
            [0, config.focal_px, (config.height - 1) / 2],
            [0, 0, 1],
        ]
    )
    cameras = []
    for view in range(views):
        azimuth = first + 2 * np.pi * view / views
        elevation = np.deg2rad(rng.uniform(*config.elevation_deg))
        distance = rng.uniform(*config.distance_m)
        offset = distance * np.array(
            [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)]
        )
        cameras.append(Camera(K, config.width, config.height, look_at(target + offset, target)))
    return cameras


class Renderer:
    """A scene ready to be seen from any number of cameras."""

    def __init__(self, objects: Sequence[PlacedObject], surroundings: Surroundings) -> None:
        self.surroundings = surroundings
        self._models = [item.model for item in objects]
        self._rotations = [item.T_world_object[:3, :3] for item in objects]
        placed = [
            (item.model.mesh.vertices @ R.T + item.T_world_object[:3, 3], item.model.mesh.faces)
            for item, R in zip(objects, self._rotations)
        ]
        self.scene = ray_scene([*placed, *surroundings.meshes()])

    def depth_and_labels(self, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """Depth (H, W) float32 [m] along z, NaN where nothing is hit, and labels (H, W) uint16.

        Label k is the k-th object, counted from 1.
        """
        _, hits = self._cast(camera, camera.rays)
        depth = hits["t_hit"].numpy()
        ids = hits["geometry_ids"].numpy()
        labels = np.where(ids < len(self._models), ids + 1, 0).astype(np.uint16)
        return np.where(np.isfinite(depth), depth, np.nan).astype(np.float32), labels

    def rgb(self, camera: Camera, rng: np.random.Generator) -> np.ndarray:
        """Shaded colour image (H, W, 3) uint8; where it varies, FINE x FINE rays a pixel smooth it."""
        from scipy import ndimage

        surface = self._surface(camera, camera.rays)
        shadows = cast_shadows(self.scene, surface, rng)
        image = shade(surface, shadows)
        brightness = image.sum(axis=-1)
        contrast = ndimage.maximum_filter(brightness, 3) - ndimage.minimum_filter(brightness, 3)
        rows, columns = np.nonzero(contrast > FINE_CONTRAST)
        offsets = (np.arange(FINE) + 0.5) / FINE - 0.5
        du, dv = np.meshgrid(offsets / camera.K[0, 0], offsets / camera.K[1, 1])
        rays = np.repeat(camera.rays[rows, columns][:, None], FINE * FINE, axis=1)  # (N, FINE * FINE, 3)
        rays[..., 0] += du.ravel()
        rays[..., 1] += dv.ravel()
        fine = shade(self._surface(camera, rays), shadows[rows, columns][:, None])
        image[rows, columns] = fine.mean(axis=1)
        return np.clip(image * 255 + 0.5, 0, 255).astype(np.uint8)

    def _cast(self, camera: Camera, rays: np.ndarray) -> tuple[np.ndarray, dict]:
        """Directions (..., 3) in the world frame and hits of rays (..., 3) of the camera frame."""
        T = camera.T_world_camera.astype(np.float32)
        directions = rays @ T[:3, :3].T
        origins = np.broadcast_to(T[:3, 3], directions.shape)
        # Directions keep z = 1 in the camera frame, so that t_hit is the depth along the camera's z axis.
        return directions, self.scene.cast_rays(tensor(np.concatenate([origins, directions], axis=-1)))

    def _surface(self, camera: Camera, rays: np.ndarray) -> Surface:
        """Positions, normals and colours of what the rays (..., 3) hit, in the world frame."""
        directions, hits = self._cast(camera, rays)
        t = hits["t_hit"].numpy()
        hit = np.isfinite(t)
        eye = camera.T_world_camera[:3, 3].astype(np.float32)
        positions = eye + directions * np.where(hit, t, 0)[..., None]
        normals = hits["primitive_normals"].numpy().copy()
        ids, triangles = hits["geometry_ids"].numpy(), hits["primitive_ids"].numpy()
        uv = hits["primitive_uvs"].numpy()
        albedo = np.zeros((*t.shape, 3), np.float32)
        outside = hit & (ids >= len(self._models))
        albedo[outside] = self.surroundings.color(ids[outside] - len(self._models), positions[outside])
        for index, model in enumerate(self._models):
            mask = ids == index
            if not mask.any():
                continue
            faces, weights = triangles[mask], barycentric(uv[mask])
            albedo[mask] = object_color(model, faces, weights)
            smooth = np.einsum("nc,ncd->nd", weights, model.corner_normals[faces])
            normals[mask] = smooth @ self._rotations[index].T
        normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-9)
        away = (normals * directions).sum(axis=-1) > 0
        normals[away] *= -1
        return Surface(hit, positions, normals, albedo, directions)


def barycentric(uv: np.ndarray) -> np.ndarray:
    """Weights (N, 3) of a triangle's corners from the ray caster's coordinates (N, 2)."""
    return np.concatenate([1 - uv.sum(axis=1, keepdims=True), uv], axis=1)


def object_color(model: ObjectModel, faces: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Colours (N, 3) in 0..1 at points of a model given by triangle (N,) and corner weights (N, 3)."""
    if model.texture is not None and model.corner_uv is not None:
        uv = np.einsum("nc,ncd->nd", weights, model.corner_uv[faces])
        height, width = model.texture.shape[:2]
        x = (uv[:, 0] % 1.0) * (width - 1)
        y = (1 - uv[:, 1] % 1.0) * (height - 1)
        return _bilinear(model.texture, x, y) / 255
    assert model.vertex_colors is not None
    corners = model.vertex_colors[model.mesh.faces[faces]].astype(np.float32)
    return np.einsum("nc,ncd->nd", weights, corners) / 255


def _bilinear(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    x1, y1 = np.minimum(x0 + 1, image.shape[1] - 1), np.minimum(y0 + 1, image.shape[0] - 1)
    fx, fy = (x - x0)[:, None], (y - y0)[:, None]
    top = image[y0, x0] * (1 - fx) + image[y0, x1] * fx
    bottom = image[y1, x0] * (1 - fx) + image[y1, x1] * fx
    return top * (1 - fy) + bottom * fy
