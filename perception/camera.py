"""A pinhole camera: intrinsics, image size and pose. Knows nothing of images or files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from mapping.errors import FrameError

RIGID_TOLERANCE = 1e-3
"""Largest deviation from an orthonormal rotation that still counts as rigid."""
MOST_OFF_AXIS = 70.0
"""Where the principal point lies outside the image, no pixel looks further off the axis [degrees]."""


@dataclass(frozen=True)
class Camera:
    """Pinhole camera in OpenCV axes (x right, y down, z forward), without lens distortion.

    K: (3, 3) intrinsics [px]. width, height: image size [px].
    T_world_camera: (4, 4) rigid pose [m]; identity when the world is the camera frame.
    The principal point may lie outside an image that was cut. Raises FrameError for NaN, focal lengths <= 0,
    a principal point so far outside that no lens sees the image, or a non-rigid pose.
    """

    K: np.ndarray
    width: int
    height: int
    T_world_camera: np.ndarray = field(default_factory=lambda: np.eye(4))

    def __post_init__(self) -> None:
        K = _matrix(self.K, (3, 3), "K")
        if K[0, 0] <= 0 or K[1, 1] <= 0:
            raise FrameError(f"K: focal lengths must be > 0 px, got fx={K[0, 0]:g}, fy={K[1, 1]:g}")
        off_axis = _degrees_off_axis(K, self.width, self.height)
        if off_axis > MOST_OFF_AXIS and not _inside(K, self.width, self.height):
            raise FrameError(
                f"K: principal point ({K[0, 2]:g}, {K[1, 2]:g}) lies outside the {self.width}x{self.height} "
                f"image, which would be seen {off_axis:.0f} degrees off the axis; K must belong to this "
                "image size (rescale it if the image was resized)"
            )
        T = _matrix(self.T_world_camera, (4, 4), "T_world_camera")
        R = T[:3, :3]
        rigid = (
            np.abs(R @ R.T - np.eye(3)).max() < RIGID_TOLERANCE
            and np.linalg.det(R) > 0
            and np.abs(T[3] - [0, 0, 0, 1]).max() < RIGID_TOLERANCE
        )
        if not rigid:
            raise FrameError("T_world_camera is not a rigid transform (rotation not orthonormal or scaled)")
        object.__setattr__(self, "K", K)
        object.__setattr__(self, "T_world_camera", T)

    @property
    def sees_axis(self) -> bool:
        """Whether the principal point lies within the image: not so in a cut far from the middle."""
        return _inside(self.K, self.width, self.height)

    @cached_property
    def rays(self) -> np.ndarray:
        """(H, W, 3) float32 directions through the pixel centres in the camera frame, z = 1."""
        u = (np.arange(self.width) - self.K[0, 2]) / self.K[0, 0]
        v = (np.arange(self.height) - self.K[1, 2]) / self.K[1, 1]
        skew = -self.K[0, 1] / self.K[0, 0] * v
        rays = np.empty((self.height, self.width, 3), np.float32)
        rays[..., 0] = u[None, :] + skew[:, None]
        rays[..., 1] = v[:, None]
        rays[..., 2] = 1.0
        return rays

    def back_project(self, depth: np.ndarray) -> np.ndarray:
        """Points (H, W, 3) float32 [m] in the camera frame; depth (H, W) [m] along z, NaN stays NaN."""
        points = np.empty((*depth.shape, 3), np.result_type(self.rays, depth))
        for axis in (0, 1):
            np.multiply(self.rays[..., axis], depth, out=points[..., axis])
        points[..., 2] = depth
        return points

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixel coordinates (N, 2) [px] and depth (N,) [m] of points (N, 3) in the camera frame."""
        z = points[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y = points[:, 0] / z, points[:, 1] / z
        u = self.K[0, 0] * x + self.K[0, 1] * y + self.K[0, 2]
        v = self.K[1, 1] * y + self.K[1, 2]
        return np.stack([u, v], axis=1), z


def transform(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Apply the rigid T (4, 4) to points (..., 3); keeps the points' dtype."""
    R, t = T[:3, :3].astype(points.dtype), T[:3, 3].astype(points.dtype)
    return points @ R.T + t


def invert_rigid(T: np.ndarray) -> np.ndarray:
    """Inverse of a rigid transform (4, 4)."""
    inverse = np.eye(4)
    inverse[:3, :3] = T[:3, :3].T
    inverse[:3, 3] = -T[:3, :3].T @ T[:3, 3]
    return inverse


def look_at(eye: np.ndarray, target: np.ndarray, up: Sequence[float] | np.ndarray = (0, 0, 1)) -> np.ndarray:
    """T_world_camera (4, 4), OpenCV axes, of a level camera at `eye` (3,) [m] that looks at `target` (3,)."""
    forward = np.asarray(target, float) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    T = np.eye(4)
    T[:3, 0], T[:3, 1], T[:3, 2], T[:3, 3] = right, np.cross(forward, right), forward, eye
    return T


def _inside(K: np.ndarray, width: int, height: int) -> bool:
    return bool(0 <= K[0, 2] < width and 0 <= K[1, 2] < height)


def _degrees_off_axis(K: np.ndarray, width: int, height: int) -> float:
    """Angle between the optical axis and the ray that is furthest off it, along one side of the image."""
    x, y = K[0, 2], K[1, 2]
    return float(
        np.degrees(np.arctan(max(x / K[0, 0], (width - x) / K[0, 0], y / K[1, 1], (height - y) / K[1, 1])))
    )


def _matrix(value: np.ndarray, shape: tuple[int, int], name: str) -> np.ndarray:
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise FrameError(f"{name} must be a {shape[0]}x{shape[1]} matrix of numbers") from error
    if matrix.shape != shape:
        raise FrameError(f"{name} must have shape {shape}, got {matrix.shape}")
    if not np.isfinite(matrix).all():
        raise FrameError(f"{name} holds NaN or infinite values")
    matrix.setflags(write=False)
    return matrix
