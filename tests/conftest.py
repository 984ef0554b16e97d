"""Synthetic tabletop frames with known truth, ray-cast by Open3D; for the tests of every package.

`tabletop_frame` is the plain one; `make_tabletop` makes others (camera, noise, objects, walls, bleed).
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field

if workers := os.environ.get("PYTEST_XDIST_WORKER_COUNT"):
    # Before anything loads an OpenMP library: workers side by side share the cores, not fight for them.
    os.environ.setdefault("OMP_NUM_THREADS", str(max(1, (os.cpu_count() or 1) // int(workers))))

import numpy as np
import pytest

from perception import Camera, Frame

TABLE = 0
"""Instance number of the table; walls and floors are 65535 and below, objects 1, 2, ..."""


@dataclass(frozen=True)
class Shape:
    """A box, sphere or cylinder; size: full lengths, radius, or radius and height [m]; yaw [rad]."""

    kind: str
    size: tuple[float, ...]
    position: tuple[float, float, float]  # centre in the world frame [m]; the table is z = 0
    yaw: float = 0.0


OBJECTS = (
    Shape("box", (0.06, 0.16, 0.20), (0.10, 0.12, 0.10), 0.4),
    Shape("sphere", (0.04,), (-0.02, -0.10, 0.04)),
    Shape("cylinder", (0.035, 0.12), (-0.08, 0.08, 0.06)),
    Shape("box", (0.08, 0.05, 0.04), (0.08, -0.12, 0.02), -0.7),
)


@dataclass(frozen=True)
class Tabletop:
    """A frame with its truth. T_world_camera of the frame: the table is z = 0 of the world."""

    frame: Frame
    shapes: tuple[Shape, ...]
    true_depth: np.ndarray  # (H, W) [m] without noise
    true_labels: np.ndarray  # (H, W) uint16 without bleed
    scene: object = field(repr=False)  # open3d RaycastingScene in the world frame


def look_at(eye: tuple[float, float, float], target: tuple[float, float, float]) -> np.ndarray:
    """T_world_camera (4, 4) of an upright OpenCV camera at eye that looks at target."""
    forward = np.subtract(target, eye) / np.linalg.norm(np.subtract(target, eye))
    right = np.cross(forward, [0.0, 0.0, 1.0])
    if np.linalg.norm(right) < 1e-6:
        right = np.array([1.0, 0.0, 0.0])
    right /= np.linalg.norm(right)
    T = np.eye(4)
    T[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    T[:3, 3] = eye
    return T


def shape_mesh(shape: Shape):
    """The triangle mesh of a shape in the world frame."""
    import open3d as o3d

    if shape.kind == "box":
        mesh = o3d.geometry.TriangleMesh.create_box(*shape.size)
        mesh.translate(-np.array(shape.size) / 2)
    elif shape.kind == "sphere":
        mesh = o3d.geometry.TriangleMesh.create_sphere(shape.size[0], 30)
    elif shape.kind == "cylinder":
        mesh = o3d.geometry.TriangleMesh.create_cylinder(shape.size[0], shape.size[1], 40)
    elif shape.kind == "lying cylinder":  # along x
        mesh = o3d.geometry.TriangleMesh.create_cylinder(shape.size[0], shape.size[1], 40)
        mesh.rotate(mesh.get_rotation_matrix_from_axis_angle([0.0, np.pi / 2, 0.0]), center=(0, 0, 0))
    else:
        raise ValueError(shape.kind)
    turn = mesh.get_rotation_matrix_from_axis_angle([0.0, 0.0, shape.yaw])
    return mesh.rotate(turn, center=(0, 0, 0)).translate(shape.position)


def make_tabletop(
    shapes: tuple[Shape, ...] = OBJECTS,
    eye: tuple[float, float, float] = (-0.55, 0.0, 0.50),
    target: tuple[float, float, float] = (0.02, 0.0, 0.04),
    size: tuple[int, int] = (320, 240),
    noise: float = 0.0,
    table: tuple[float, float] = (1.0, 1.2),
    background: tuple[Shape, ...] = (),
    seed: int = 0,
) -> Tabletop:
    """Ray-cast a table (lengths along x and y [m], 2 cm thick) with shapes on it.

    size: image width and height [px]. noise: standard deviation of depth at 1 m [m], growing with its square.
    background: unlabelled shapes: walls, floors. Without shapes the frame has no labels. The seed
    drives the noise.
    """
    import open3d as o3d

    camera = Camera(
        np.array([[size[0] * 0.95, 0, size[0] / 2 - 0.5], [0, size[0] * 0.95, size[1] / 2 - 0.5], [0, 0, 1]]),
        size[0],
        size[1],
        look_at(eye, target),
    )
    scene = o3d.t.geometry.RaycastingScene()
    slab = Shape("box", (table[0], table[1], 0.02), (0.0, 0.0, -0.01))
    for shape in (slab, *shapes, *background):
        scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(shape_mesh(shape)))
    directions = camera.rays.reshape(-1, 3) @ camera.T_world_camera[:3, :3].T.astype(np.float32)
    origin = np.broadcast_to(camera.T_world_camera[:3, 3].astype(np.float32), directions.shape)
    hits = scene.cast_rays(o3d.core.Tensor(np.concatenate([origin, directions], axis=1)))
    # Rays have z = 1 in the camera frame, so the ray parameter is the depth.
    depth = hits["t_hit"].numpy().reshape(size[1], size[0])
    instance = hits["geometry_ids"].numpy().reshape(size[1], size[0]).astype(np.int64)
    labels = np.where((instance >= 1) & (instance <= len(shapes)), instance, 0).astype(np.uint16)
    depth = np.where(np.isfinite(depth), depth, np.nan).astype(np.float32)
    generator = np.random.default_rng(seed)
    noisy = depth + (noise * depth**2 * generator.standard_normal(depth.shape)).astype(np.float32)
    rgb = np.full((size[1], size[0], 3), 128, np.uint8)
    names = {index + 1: f"{shape.kind}_{index + 1}" for index, shape in enumerate(shapes)}
    frame = Frame(noisy, camera, rgb, labels if shapes else None, names, "synthetic tabletop")
    return Tabletop(frame, shapes, depth, labels, scene)


@pytest.fixture(scope="session")
def tabletop() -> Tabletop:
    """Four objects on a table with sensor noise, and their truth."""
    return make_tabletop(noise=0.0015)


@pytest.fixture(scope="session")
def tabletop_frame(tabletop: Tabletop) -> Frame:
    """The frame of `tabletop`: 320x240, boxes, a sphere and a cylinder, labels 1 to 4."""
    return tabletop.frame
