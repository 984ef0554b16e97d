"""What one frame says of space: free, surface, occluded, out of view or below the support, for any points."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from perception.camera import Camera, invert_rigid, transform
from perception.config import PerceptionConfig
from perception.observation import Observation


class Region(IntEnum):
    """What the frame says of a point."""

    FREE = 0  # a ray passed through it
    SURFACE = 1  # within the margin of a measured depth
    OCCLUDED = 2  # behind a measured depth
    OUT_OF_VIEW = 3  # outside the image, or its pixel measured nothing: the frame says nothing of it
    BELOW_SUPPORT = 4  # under the support plane, whatever the rays say


@dataclass(frozen=True)
class Space:
    """The space of one frame; points are (N, 3) float32 [m] in the table frame.

    A pixel without depth says nothing: points behind it are OUT_OF_VIEW, neither free nor occluded.
    """

    camera: Camera
    depth: np.ndarray  # (H, W) float32 [m], NaN where nothing was measured
    T_camera_table: np.ndarray  # (4, 4)
    has_support: bool
    config: PerceptionConfig

    @classmethod
    def of(cls, observation: Observation, config: PerceptionConfig | None = None) -> Space:
        """The space that an observation shows."""
        return cls(
            observation.camera,
            observation.depth,
            invert_rigid(observation.T_table_camera),
            observation.support is not None,
            config or PerceptionConfig(),
        )

    @property
    def origin(self) -> np.ndarray:
        """(3,) the camera's centre in the table frame [m]: where all rays start."""
        return invert_rigid(self.T_camera_table)[:3, 3]

    def pixel_of(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Flat pixel index (N,) int32 of each point, -1 outside the image, and depth (N,) float32 [m]."""
        in_camera = transform(self.T_camera_table, np.asarray(points, np.float32))
        z = np.ascontiguousarray(in_camera[:, 2])
        K = self.camera.K.astype(np.float32)
        # Points behind the camera get a pixel outside the image.
        inverse = np.float32(1) / np.where(z > 1e-6, z, np.float32(1e-6))
        u = (K[0, 0] * in_camera[:, 0] + K[0, 1] * in_camera[:, 1]) * inverse + K[0, 2]
        v = K[1, 1] * in_camera[:, 1] * inverse + K[1, 2]
        inside = (u > -0.5) & (u < self.camera.width - 0.5) & (v > -0.5) & (v < self.camera.height - 0.5)
        inside &= z > 1e-6
        column = np.rint(np.where(inside, u, 0)).astype(np.int32)
        row = np.rint(np.where(inside, v, 0)).astype(np.int32)
        return np.where(inside, row * np.int32(self.camera.width) + column, np.int32(-1)), z

    def depth_behind(self, points: np.ndarray) -> np.ndarray:
        """Depth of each point behind the measured surface along z (N,) float32 [m]; NaN where unknown."""
        return self._depth_behind(points)[0]

    def classify(self, points: np.ndarray) -> np.ndarray:
        """The Region of each point, (N,) int8."""
        behind, z = self._depth_behind(points)
        margin = np.float32(self.config.surface_margin) + np.float32(2 * self.config.depth_noise) * z * z
        region = np.full(len(z), Region.SURFACE, np.int8)
        region[behind < -margin] = Region.FREE
        region[behind > margin] = Region.OCCLUDED
        region[np.isnan(behind)] = Region.OUT_OF_VIEW
        if self.has_support:
            region[points[:, 2] < -self.config.surface_margin] = Region.BELOW_SUPPORT
        return region

    def _depth_behind(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        pixel, z = self.pixel_of(points)
        # One NaN after the last pixel: index -1, outside the image, reads as unknown.
        measured = np.append(self.depth.reshape(-1), np.float32(np.nan))
        return z - measured[pixel], z
