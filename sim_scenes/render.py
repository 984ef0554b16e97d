"""Draws a tabletop scene by ray casting: metric depth, instance labels and a shaded colour image.

Runs anywhere open3d runs, without a display or OpenGL. World: z up, table top at z = 0, in a room.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from perception.camera import Camera
from sim_scenes.object_model import ObjectModel
from sim_scenes.shading import Surface, shade
from sim_scenes.surroundings import Surroundings
from sim_scenes.tabletop import PlacedObject

SMOOTH_ANGLE_COSINE = 0.8
"""Corners where the surface turns more than this keep their edge when shaded."""
MOST_CORNERS = 24
"""Triangles that meet in a vertex beyond this number are left out when its normal is smoothed."""


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


def look_at(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """T_world_camera (4, 4), OpenCV axes, of a level camera at `eye` that looks at `target`."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    T = np.eye(4)
    T[:3, 0], T[:3, 1], T[:3, 2], T[:3, 3] = right, np.cross(forward, right), forward, eye
    return T


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
        import open3d

        self._tensor = open3d.core.Tensor.from_numpy
        self.scene = open3d.t.geometry.RaycastingScene()
        self.surroundings = surroundings
        self._models = [item.model for item in objects]
        self._rotations = [item.T_world_object[:3, :3] for item in objects]
        for item in objects:
            vertices = item.model.mesh.vertices @ item.T_world_object[:3, :3].T + item.T_world_object[:3, 3]
            self._add(vertices, item.model.mesh.faces)
        for vertices, faces in surroundings.meshes():
            self._add(vertices, faces)

    @cached_property
    def _normals(self) -> list[np.ndarray]:
        return [corner_normals(model) for model in self._models]

    def _add(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self.scene.add_triangles(
            self._tensor(np.ascontiguousarray(vertices, np.float32)),
            self._tensor(np.ascontiguousarray(faces, np.uint32)),
        )

    def depth_and_labels(self, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """Depth (H, W) float32 [m] along z, NaN where nothing is hit, and labels (H, W) uint16.

        Label k is the k-th object, counted from 1.
        """
        hits = self._cast(camera, camera.rays)
        depth = hits["t_hit"].numpy()
        ids = hits["geometry_ids"].numpy()
        labels = np.where(ids < len(self._models), ids + 1, 0).astype(np.uint16)
        return np.where(np.isfinite(depth), depth, np.nan).astype(np.float32), labels

    def rgb(self, camera: Camera, rng: np.random.Generator, oversample: int = 2) -> np.ndarray:
        """Shaded colour image (H, W, 3) uint8, `oversample` rays a pixel along each axis."""
        fine = _finer(camera, oversample)
        hits = self._cast(fine, fine.rays)
        surface = self._surface(fine, hits)
        image = shade(self.scene, surface, rng, oversample)
        image = image.reshape(camera.height, oversample, camera.width, oversample, 3).mean(axis=(1, 3))
        return np.clip(image * 255 + 0.5, 0, 255).astype(np.uint8)

    def _cast(self, camera: Camera, rays: np.ndarray) -> dict:
        T = camera.T_world_camera.astype(np.float32)
        directions = rays @ T[:3, :3].T
        origins = np.broadcast_to(T[:3, 3], directions.shape)
        # Directions keep z = 1 in the camera frame, so that t_hit is the depth along the camera's z axis.
        return self.scene.cast_rays(self._tensor(np.concatenate([origins, directions], axis=-1)))

    def _surface(self, camera: Camera, hits: dict) -> Surface:
        """Positions, normals and colours of what the rays hit, in the world frame."""
        T = camera.T_world_camera.astype(np.float32)
        directions = camera.rays @ T[:3, :3].T
        t = hits["t_hit"].numpy()
        hit = np.isfinite(t)
        positions = T[:3, 3] + directions * np.where(hit, t, 0)[..., None]
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
            smooth = np.einsum("nc,ncd->nd", weights, self._normals[index][faces])
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


def corner_normals(model: ObjectModel) -> np.ndarray:
    """Unit normals (F, 3, 3) per triangle corner: smooth, but sharp where the surface has an edge."""
    faces, flat = np.asarray(model.mesh.faces), np.asarray(model.mesh.face_normals)
    areas = np.asarray(model.mesh.area_faces)
    # Corners that share a vertex lie next to each other once sorted by vertex; pair each with the next ones.
    order = np.argsort(faces.ravel(), kind="stable")
    vertex, face = faces.ravel()[order], order // 3
    total = areas[face, None] * flat[face]
    for step in range(1, MOST_CORNERS):
        same = vertex[step:] == vertex[:-step]
        if not same.any():
            break
        first, second = np.flatnonzero(same), np.flatnonzero(same) + step
        alike = np.einsum("nd,nd->n", flat[face[first]], flat[face[second]]) > SMOOTH_ANGLE_COSINE
        first, second = first[alike], second[alike]
        np.add.at(total, first, areas[face[second], None] * flat[face[second]])
        np.add.at(total, second, areas[face[first], None] * flat[face[first]])
    normals = np.empty_like(total)
    normals[order] = total
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
    return normals.reshape(-1, 3, 3).astype(np.float32)


def _bilinear(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
    x1, y1 = np.minimum(x0 + 1, image.shape[1] - 1), np.minimum(y0 + 1, image.shape[0] - 1)
    fx, fy = (x - x0)[:, None], (y - y0)[:, None]
    top = image[y0, x0] * (1 - fx) + image[y0, x1] * fx
    bottom = image[y1, x0] * (1 - fx) + image[y1, x1] * fx
    return top * (1 - fy) + bottom * fy


def _finer(camera: Camera, factor: int) -> Camera:
    """The same camera with `factor` times the pixels along each axis."""
    K = camera.K.copy()
    K[:2, :2] *= factor
    K[:2, 2] = (K[:2, 2] + 0.5) * factor - 0.5
    return Camera(K, camera.width * factor, camera.height * factor, camera.T_world_camera)
