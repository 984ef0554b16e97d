"""Organised point clouds (PCD, PLY): one point a pixel, turned back into a depth image and its camera."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mapping.errors import FrameError
from mapping.guarded_files import check_plain
from perception.camera import invert_rigid
from perception.inputs.pose import compose, quaternion_matrix

LABEL_NAMES = ("label", "labels", "instance", "object", "segment", "intensity_label")
"""Point attributes that hold the instance label."""
RESIDUAL = 1.0
"""Largest error of the fitted pinhole camera at 95 % of the points [px]."""
FIT_POINTS = 20_000
"""Points that the camera is fitted to."""


@dataclass(frozen=True)
class Cloud:
    """depth: (H, W) float32 [m], NaN where missing; K (3, 3); T_world_camera (4, 4); labels (H, W), rgb or
    None."""

    depth: np.ndarray
    K: np.ndarray
    T_world_camera: np.ndarray
    labels: np.ndarray | None
    rgb: np.ndarray | None
    notes: tuple[str, ...]


def read_cloud(path: Path, size: tuple[int, int] | None = None) -> Cloud:
    """The frame that an organised cloud was made from.

    size: width and height where the file does not say them (PLY). The camera is fitted to the points, in
    whatever frame they are; a pose in the header (PCD's VIEWPOINT) is used. Raises FrameError.
    """
    import open3d as o3d

    header = _header(path)
    width, height, viewpoint = _organisation(header, path)
    if height <= 1:
        if size is None:
            raise FrameError(
                f"{path}: is not organised (one point a pixel, rows by columns), so free space and labels "
                f"cannot be "
                "told; save the organised cloud, or depth and K"
            )
        width, height = size
    cloud = o3d.t.io.read_point_cloud(path, remove_nan_points=False, remove_infinite_points=False)
    names = set(cloud.point)
    if "positions" not in names:
        raise FrameError(f"{path}: holds no points; save it again")
    points = cloud.point.positions.numpy().astype(np.float64)
    if len(points) != width * height:
        raise FrameError(
            f"{path}: holds {len(points)} points, its size {width}x{height} has {width * height}"
        )
    grid = points.reshape(height, width, 3)
    grid[~np.isfinite(grid).all(2) | (grid == 0).all(2)] = np.nan
    K, T_points_camera = fit_camera(grid, path)
    inverse = invert_rigid(T_points_camera)
    depth = grid @ inverse[2, :3] + inverse[2, 3]
    labels = next(
        (cloud.point[key].numpy().reshape(height, width) for key in LABEL_NAMES if key in names), None
    )
    rgb = None
    if "colors" in names:
        colors = cloud.point.colors.numpy().reshape(height, width, 3)
        rgb = (
            colors.astype(np.uint8)
            if colors.dtype == np.uint8
            else np.rint(255 * colors).clip(0, 255).astype(np.uint8)
        )
    # A viewpoint is the sensor's pose for points in the sensor's own frame.
    pose = viewpoint if np.array_equal(T_points_camera, np.eye(4)) else T_points_camera
    fitted = f"fx {K[0, 0]:.1f}, fy {K[1, 1]:.1f}, cx {K[0, 2]:.1f}, cy {K[1, 2]:.1f}"
    note = f"{path.name}: camera fitted to the points: {fitted}"
    return Cloud(depth.astype(np.float32), K, pose, labels, rgb, (note,))


def fit_camera(grid: np.ndarray, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """K (3, 3) and T_points_camera (4, 4) of the pinhole camera that sees points (H, W, 3) at their pixels.

    Points in the camera's own frame are tried first, then any frame (direct linear transformation).
    Raises FrameError when no pinhole camera fits.
    """
    row, column = np.nonzero(np.isfinite(grid[..., 2]))
    if len(row) < 100:
        raise FrameError(f"{path}: only {len(row)} measured points")
    step = 1 + len(row) // FIT_POINTS
    row, column = row[::step], column[::step]
    points = grid[row, column]
    if (points[:, 2] > 0).all():
        K = np.eye(3)
        for axis, pixel in ((0, column), (1, row)):
            A = np.stack([points[:, axis] / points[:, 2], np.ones(len(points))], 1)
            (K[axis, axis], K[axis, 2]), *_ = np.linalg.lstsq(A, pixel, rcond=None)
        if K[0, 0] > 0 and K[1, 1] > 0 and _error(K, np.eye(4), points, column, row) < RESIDUAL:
            return K, np.eye(4)
    K, T = _resection(points, column, row)
    if not (K[0, 0] > 0 and K[1, 1] > 0) or _error(K, T, points, column, row) > RESIDUAL:
        raise FrameError(
            f"{path}: no pinhole camera sees these points at their pixels (rows and columns swapped, a "
            f"lidar, or a "
            "cloud that was filtered or reordered?); give depth and K"
        )
    return K, T


def _resection(points: np.ndarray, column: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """K and T_points_camera by the direct linear transformation."""
    import cv2

    centre, spread = points.mean(0), points.std()
    X = np.concatenate([(points - centre) / spread, np.ones((len(points), 1))], 1)
    scale = max(column.max(), row.max())
    u, v = column / scale, row / scale
    zero = np.zeros_like(X)
    A = np.concatenate(
        [np.concatenate([X, zero, -u[:, None] * X], 1), np.concatenate([zero, X, -v[:, None] * X], 1)]
    )
    P = np.linalg.eigh(A.T @ A)[1][:, 0].reshape(3, 4)
    P = (
        np.diag([scale, scale, 1.0])
        @ P
        @ np.block([[np.eye(3) / spread, -centre[:, None] / spread], [np.zeros((1, 3)), 1]])
    )
    if (points @ P[2, :3] + P[2, 3]).mean() < 0:
        P = -P
    K, R, place, *_ = cv2.decomposeProjectionMatrix(P)
    signs = np.diag(np.sign(np.diag(K)))  # focal lengths > 0
    K, R = K @ signs, signs @ R
    return K / K[2, 2], compose(R.T, (place[:3] / place[3]).reshape(3))


def _error(K: np.ndarray, T: np.ndarray, points: np.ndarray, column: np.ndarray, row: np.ndarray) -> float:
    inverse = invert_rigid(T)
    own = points @ inverse[:3, :3].T + inverse[:3, 3]
    if (own[:, 2] <= 0).any():
        return float("inf")
    uv = (own / own[:, 2:]) @ K.T
    return float(np.quantile(np.hypot(uv[:, 0] - column, uv[:, 1] - row), 0.95))


def _header(path: Path) -> str:
    check_plain(path, "give an organised .pcd or .ply", FrameError)
    with path.open("rb") as file:
        return file.read(4096).decode("ascii", "ignore")


def _organisation(header: str, path: Path) -> tuple[int, int, np.ndarray]:
    """Width, height and T_world_points (4, 4) that the header states; height 1 where it states none."""
    T = np.eye(4)
    if path.suffix == ".pcd":
        found = {
            name: re.search(rf"^{name} (.+)$", header, re.M) for name in ("WIDTH", "HEIGHT", "VIEWPOINT")
        }
        if found["WIDTH"] is None or found["HEIGHT"] is None:
            raise FrameError(f"{path}: not a PCD file (its header lacks WIDTH and HEIGHT)")
        if (view := found["VIEWPOINT"]) is not None:
            x, y, z, qw, qx, qy, qz = (float(word) for word in view[1].split())
            T = compose(
                quaternion_matrix(np.array([qx, qy, qz, qw]), f"{path}: VIEWPOINT"), np.array([x, y, z])
            )
        return int(found["WIDTH"][1]), int(found["HEIGHT"][1]), T
    if not header.startswith("ply"):
        raise FrameError(f"{path}: not a PLY file; give an organised .pcd or .ply")
    sides = [
        re.search(rf"^(?:obj_info|comment) (?:num_)?{word}s?:? (\d+)\s*$", header, re.M | re.I)
        for word in ("(?:col|width)", "(?:row|height)")
    ]
    if sides[0] is None or sides[1] is None:
        return 0, 1, T
    return int(sides[0][1]), int(sides[1][1]), T
