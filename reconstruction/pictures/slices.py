"""A horizontal cut through the objects: p(uncertain) on it, and where it cuts meshes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import trimesh

from perception.camera import invert_rigid, transform

if TYPE_CHECKING:
    from reconstruction.result import Reconstruction


STEEP = 0.85
"""Cosine between the line of sight and the vertical from which on a picture's upper side is the image's."""


@dataclass(frozen=True)
class SliceConfig:
    """Which part of space the slice shows."""

    columns: int = 176
    """Points evaluated across the slice."""
    aspect: float = 4 / 3
    """Width of the slice over its height."""
    margin: float = 0.07
    """Space shown around the objects [m]."""


@dataclass(frozen=True)
class UncertaintySlice:
    """p(uncertain) on a horizontal lattice, the top row farthest from the camera, columns to its right.

    values: (rows, columns) in [0, 1]; origin: (3,) world position [m] of value (0, 0); down, right: (3,)
    world steps [m] between rows and columns; height: above the support plane [m], or along up without one.
    """

    values: np.ndarray
    origin: np.ndarray
    down: np.ndarray
    right: np.ndarray
    height: float

    @property
    def spacing(self) -> float:
        """Distance between neighbouring values [m]."""
        return float(np.linalg.norm(self.right))

    @property
    def corners(self) -> np.ndarray:
        """World positions (4, 3) [m] of values (0, 0), (0, last), (last, last) and (last, 0)."""
        rows, columns = self.values.shape
        across, along = (columns - 1) * self.right, (rows - 1) * self.down
        return self.origin + np.stack([0 * across, across, across + along, along])

    def outline(self, mesh: trimesh.Trimesh) -> np.ndarray:
        """Segments (S, 2, 2) in (column, row) where the slice cuts a mesh in the world frame."""
        from trimesh.intersections import mesh_plane

        normal = np.cross(self.right, self.down)
        segments = mesh_plane(mesh, normal / np.linalg.norm(normal), self.origin).reshape(-1, 2, 3)
        return (segments - self.origin) @ np.stack([self.right, self.down], axis=1) / self.spacing**2


def table_axes(reconstruction: Reconstruction) -> np.ndarray:
    """Rows (3, 3): the directions away from the camera, to its left, and up, in the world frame.

    With a support plane these are the table frame's axes, turned about up as the image is where the camera
    looks steeply down; without one, the camera's.
    """
    R = reconstruction.T_world_table[:3, :3]
    supported = reconstruction.observation.support is not None
    axes = directions(supported) @ R.T
    _, downward, view = reconstruction.frame.camera.T_world_camera[:3, :3].T
    if not supported or abs(view @ axes[2]) < STEEP:
        return axes
    away = -downward + (downward @ axes[2]) * axes[2]
    away = away / np.linalg.norm(away)
    return np.stack([away, np.cross(axes[2], away), axes[2]])


def directions(upright: bool) -> np.ndarray:
    """Rows (3, 3): the directions away from the camera, to its left, and up, in the table frame.

    upright: whether there is a support; without one, the table frame is the camera's.
    """
    return np.eye(3) if upright else np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def slice_uncertainty(reconstruction: Reconstruction, config: SliceConfig | None = None) -> UncertaintySlice:
    """Evaluate p(uncertain) on the horizontal plane that cuts the most objects near their middles."""
    config = config or SliceConfig()
    axes = table_axes(reconstruction)
    base = reconstruction.T_world_table[:3, 3]
    bounds = np.array([_bounds((item.mesh.vertices - base) @ axes.T) for item in reconstruction.objects])
    height = _shared_height(bounds[:, 0, 2], bounds[:, 1, 2])
    low = bounds[:, 0].min(0) - config.margin
    high = bounds[:, 1].max(0) + config.margin
    width = max(high[1] - low[1], (high[0] - low[0]) * config.aspect)
    spacing = width / (config.columns - 1)
    rows = round(config.columns / config.aspect)
    middle = (low + high) / 2
    start = np.array([middle[0] + spacing * (rows - 1) / 2, middle[1] + width / 2, height])
    origin = base + start @ axes
    down, right = -spacing * axes[0], -spacing * axes[1]
    lattice = (
        origin + np.arange(rows)[:, None, None] * down + np.arange(config.columns)[None, :, None] * right
    )
    table = transform(invert_rigid(reconstruction.T_world_table), lattice.reshape(-1, 3))
    values = reconstruction.map.predict_proba(table.astype(np.float32))[:, -1]
    return UncertaintySlice(np.asarray(values).reshape(rows, -1), origin, down, right, height)


def _shared_height(low: np.ndarray, high: np.ndarray) -> float:
    """The middle height of an object that cuts the most objects; of several, the one nearest their median.

    low, high: (K,) heights [m] of the objects. A cut through the lowest or highest tenth does not count.
    """
    middle, rim = (low + high) / 2, (high - low) / 10
    cuts = (middle[:, None] > low + rim) & (middle[:, None] < high - rim)  # (K heights, K objects)
    count = cuts.sum(axis=1)
    best = middle[count == count.max()]
    return float(best[np.argmin(np.abs(best - np.median(middle)))])


def _bounds(points: np.ndarray) -> np.ndarray:
    return np.stack([points.min(0), points.max(0)])
