"""Shaded pictures of triangle meshes without a display or a GPU, by Open3D's ray casting.

Knows meshes, colours and a camera; nothing of objects or maps. The rays are cast once a view, and the same
hits can then be painted in several colourings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import trimesh

from perception.camera import Camera, look_at
from perception.ray_casting import ray_scene, tensor


@dataclass(frozen=True)
class ShadingConfig:
    """How a picture is lit."""

    supersampling: int = 2
    """Rays along each side of a pixel; 2 smooths edges well."""
    background: tuple[int, int, int] = (247, 248, 250)
    """Colour [RGB] where no mesh is hit."""
    ambient: float = 0.42
    """Light that reaches every surface."""
    key_light: float = 0.52
    """Light from the lamp, at normal incidence."""
    head_light: float = 0.16
    """Light from the camera, at normal incidence."""
    lamp: tuple[float, float, float] = (-0.55, 0.75, 1.0)
    """Direction of the lamp as (right of the camera, up, towards the camera)."""
    shadow: float = 0.24
    """Darkening of the ground in full shadow."""
    shadow_blur: float = 0.012
    """Softness of the ground's shadows as a share of the picture's height."""
    crease_degrees: float = 35.0
    """Faces that bend more than this from their vertex normals are drawn flat, so that edges stay sharp."""


@dataclass(frozen=True)
class View:
    """What every sub-pixel of a camera sees: rays hit once, painted as often as wanted.

    vertices: (h, w, 3) indices into the concatenated vertices of all meshes; weights: (h, w, 3) barycentric;
    hit: (h, w) bool; light: (h, w) brightness; mesh: (h, w) index of the mesh hit, -1 none.
    """

    vertices: np.ndarray
    weights: np.ndarray
    hit: np.ndarray
    light: np.ndarray
    mesh: np.ndarray
    config: ShadingConfig = field(default_factory=ShadingConfig)

    def paint(self, colours: Sequence[np.ndarray]) -> np.ndarray:
        """Picture (H, W, 3) uint8 RGB; colours: for each mesh (V, 3) or (3,) RGB in 0..255."""
        import cv2

        background = np.asarray(self.config.background, np.float32)
        picture = background * np.minimum(self.light, 1.0)[..., None]
        if self.hit.any():
            table = np.concatenate(list(colours)).astype(np.float32)
            corners = table[self.vertices[self.hit]]  # (M, 3 corners, 3)
            surface = np.einsum("mc,mck->mk", self.weights[self.hit], corners)
            picture[self.hit] = surface * self.light[self.hit][:, None]
        s = self.config.supersampling
        height, width = self.hit.shape
        small = cv2.resize(picture, (width // s, height // s), interpolation=cv2.INTER_AREA)
        return np.clip(small + 0.5, 0, 255).astype(np.uint8)


def viewing_camera(
    eye: np.ndarray, target: np.ndarray, up: np.ndarray, size: tuple[int, int], field_of_view: float
) -> Camera:
    """A camera at `eye` that sees `target` in its middle.

    size: (width, height) [px]; field_of_view: vertical angle [degrees].
    """
    width, height = size
    focal = height / 2 / np.tan(np.radians(field_of_view) / 2)
    K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    return Camera(K=K, width=width, height=height, T_world_camera=look_at(eye, target, up))


def frame_meshes(
    meshes: Sequence[trimesh.Trimesh],
    direction: np.ndarray,
    up: np.ndarray,
    size: tuple[int, int],
    field_of_view: float = 24.0,
    margin: float = 1.12,
) -> Camera:
    """A camera that looks along `direction` and holds all meshes in its picture."""
    points = np.concatenate([mesh.vertices for mesh in meshes])
    direction = np.asarray(direction, float) / np.linalg.norm(direction)
    target = (points.min(0) + points.max(0)) / 2
    probe = viewing_camera(target - direction, target, up, size, field_of_view)
    slope_y = np.tan(np.radians(field_of_view) / 2) / margin
    slope = np.array([slope_y * size[0] / size[1], slope_y])
    distance = 1e-3
    for _ in range(3):  # centre the projected extent, then step back until it fits
        R = probe.T_world_camera[:3, :3]
        local = (points - target) @ R
        distance = float((np.abs(local[:, :2]) / slope - local[:, 2:]).max())
        seen = local[:, :2] / (local[:, 2:] + distance)
        target = target + R[:, :2] @ ((seen.min(0) + seen.max(0)) / 2 * distance)
    return viewing_camera(target - distance * direction, target, up, size, field_of_view)


def cast(
    meshes: Sequence[trimesh.Trimesh],
    camera: Camera,
    ground: tuple[np.ndarray, float] | None = None,
    config: ShadingConfig | None = None,
) -> View:
    """What the camera sees of the meshes, lit by a lamp at its upper left.

    ground: (normal, offset) of a plane normal . x + offset = 0 [m] that shows the meshes' shadows.
    """

    config = config or ShadingConfig()
    s = config.supersampling
    K = camera.K * s
    K[:2, 2] = (camera.K[:2, 2] + 0.5) * s - 0.5
    K[2] = [0, 0, 1]
    fine = Camera(K, camera.width * s, camera.height * s, camera.T_world_camera)
    R, eye = camera.T_world_camera[:3, :3].astype(np.float32), camera.T_world_camera[:3, 3].astype(np.float32)
    directions = fine.rays @ R.T
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    lamp = R @ (np.array(config.lamp, np.float32) * [1, -1, -1]).astype(np.float32)
    lamp /= np.linalg.norm(lamp)

    sizes = [len(mesh.vertices) for mesh in meshes]
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    scene = ray_scene((mesh.vertices, mesh.faces) for mesh in meshes)
    rays = np.concatenate([np.broadcast_to(eye, directions.shape), directions], axis=-1)
    answer = scene.cast_rays(tensor(rays))
    distance = answer["t_hit"].numpy()
    hit = np.isfinite(distance)
    mesh_index = np.where(hit, answer["geometry_ids"].numpy().astype(np.int64), -1)

    # Triangles and vertex normals of all meshes in one table, so that one look-up serves every hit.
    faces = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, offsets[:-1], strict=True)])
    first_face = np.concatenate([[0], np.cumsum([len(mesh.faces) for mesh in meshes])])
    vertices = np.zeros((*hit.shape, 3), np.int64)
    weights = np.zeros((*hit.shape, 3), np.float32)
    light = np.ones(hit.shape, np.float32)
    if hit.any():
        face = first_face[mesh_index[hit]] + answer["primitive_ids"].numpy()[hit].astype(np.int64)
        vertices[hit] = faces[face]
        uv = answer["primitive_uvs"].numpy()[hit]
        weights[hit] = np.stack([1 - uv[:, 0] - uv[:, 1], uv[:, 0], uv[:, 1]], axis=1)
        normal = _normals(
            meshes, vertices[hit], weights[hit], answer["primitive_normals"].numpy()[hit], config
        )
        toward_eye = -np.einsum("mk,mk->m", normal, directions[hit])
        normal *= np.where(toward_eye < 0, -1, 1)[:, None]
        points = eye + directions[hit] * distance[hit][:, None]
        lit = ~_blocked(scene, points + 2e-3 * normal, lamp)
        light[hit] = (
            config.ambient
            + config.key_light * np.clip(normal @ lamp, 0, None) * (0.25 + 0.75 * lit)
            + config.head_light * np.abs(toward_eye)
        )
    if ground is not None:
        light[~hit] = _ground_light(scene, ground, eye, directions, lamp, config)[~hit]
    return View(vertices, weights, hit, light, mesh_index, config)


def render(
    meshes: Sequence[trimesh.Trimesh],
    colours: Sequence[np.ndarray],
    camera: Camera,
    ground: tuple[np.ndarray, float] | None = None,
    config: ShadingConfig | None = None,
) -> np.ndarray:
    """Picture (H, W, 3) uint8 RGB of the meshes; colours: for each mesh (V, 3) RGB in 0..255."""
    return cast(meshes, camera, ground, config).paint(colours)


def _normals(
    meshes: Sequence[trimesh.Trimesh],
    vertices: np.ndarray,
    weights: np.ndarray,
    flat: np.ndarray,
    config: ShadingConfig,
) -> np.ndarray:
    """Smooth normals (M, 3) where the surface is smooth, the face's own at creases."""
    table = np.concatenate([mesh.vertex_normals for mesh in meshes]).astype(np.float32)
    corners = table[vertices]  # (M, 3 corners, 3)
    smooth = np.einsum("mc,mck->mk", weights, corners)
    smooth /= np.maximum(np.linalg.norm(smooth, axis=1, keepdims=True), 1e-9)
    flat = flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9)
    bend = np.einsum("mck,mk->mc", corners, flat).min(1)
    crease = bend < np.cos(np.radians(config.crease_degrees))
    return np.where(crease[:, None], flat, smooth).astype(np.float32)


def _blocked(scene: Any, points: np.ndarray, lamp: np.ndarray) -> np.ndarray:
    """Whether (M,) the lamp is hidden from points (M, 3)."""
    rays = np.concatenate([points, np.broadcast_to(lamp, points.shape)], axis=1).astype(np.float32)
    return scene.test_occlusions(tensor(rays)).numpy()


def _ground_light(
    scene: Any,
    ground: tuple[np.ndarray, float],
    eye: np.ndarray,
    directions: np.ndarray,
    lamp: np.ndarray,
    config: ShadingConfig,
) -> np.ndarray:
    """Brightness (h, w) of the ground: 1 in the lamp's light, less in soft shadows; meshes are ignored."""
    import cv2

    normal, offset = np.asarray(ground[0], np.float32), float(ground[1])
    # Soft shadows need no fine rays: one a pixel, blurred.
    coarse = directions[:: config.supersampling, :: config.supersampling]
    slope = coarse @ normal
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = -(eye @ normal + offset) / slope
    on_ground = np.isfinite(reach) & (reach > 0)
    points = eye + coarse[on_ground] * reach[on_ground][:, None]
    # Hidden ground under the meshes takes part in the blur, so that contact shadows stay dark.
    shadow = np.zeros(on_ground.shape, np.float32)
    shadow[on_ground] = _blocked(scene, points + 1e-3 * normal, lamp)
    shadow = cv2.GaussianBlur(shadow, (0, 0), max(config.shadow_blur * len(shadow), 1e-3))
    return 1 - config.shadow * cv2.resize(shadow, directions.shape[1::-1], interpolation=cv2.INTER_LINEAR)
