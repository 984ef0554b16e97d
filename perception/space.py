"""What one frame says of space: free, surface, occluded, out of view or below the support, for any points."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np

from perception.camera import Camera, invert_rigid
from perception.config import PerceptionConfig
from perception.observation import Observation
from perception.sights import ranks, sights


class Region(IntEnum):
    """What the frame says of a point."""

    FREE = 0  # a ray passed through it
    SURFACE = 1  # within the margin of a measured depth
    OCCLUDED = 2  # behind a measured depth
    OUT_OF_VIEW = 3  # outside the image, or its pixel measured nothing: the frame says nothing of it
    BELOW_SUPPORT = 4  # under the support plane, whatever the rays say


class Sight(NamedTuple):
    """What the camera sees on the rays through N points.

    pixel: (N,) int32 flat index of the pixel that sees the point, -1 outside the image; depth: (N,) float32
    of the point along z [m]; behind: (N,) float32 depth behind the measured surface [m], NaN where unknown.
    """

    pixel: np.ndarray
    depth: np.ndarray
    behind: np.ndarray


@dataclass(frozen=True)
class Space:
    """The space of one frame; points are (N, 3) float32 [m] in the table frame.

    A pixel without depth says nothing: points on its ray are OUT_OF_VIEW, neither free nor occluded. Where
    an object's silhouette measured nothing, its depth may be guessed: what lies behind that is OCCLUDED, the
    rest of the ray OUT_OF_VIEW, for no ray was seen to pass there.
    """

    camera: Camera
    depth: np.ndarray  # (H, W) float32 [m], NaN where nothing was measured or guessed
    T_camera_table: np.ndarray  # (4, 4)
    has_support: bool
    config: PerceptionConfig
    floor: float = 0.0  # height of the support [m]; what is under it is BELOW_SUPPORT
    guessed: np.ndarray | None = None  # (H, W) bool, where depth is a guess; None: nowhere

    @classmethod
    def of(cls, observation: Observation, config: PerceptionConfig | None = None) -> Space:
        """The space that an observation shows; the same one when asked again."""
        config = config or PerceptionConfig()
        if ("space", config) not in observation.memo:
            observation.memo["space", config] = cls._of(observation, config)
        return observation.memo["space", config]

    @classmethod
    def _of(cls, observation: Observation, config: PerceptionConfig) -> Space:
        depth, guessed = observation.depth, None
        if observation.guess is not None:
            guessed = np.isfinite(observation.guess)
            depth = np.where(guessed, observation.guess, depth)
        return cls(
            observation.camera,
            depth,
            invert_rigid(observation.T_table_camera),
            observation.support is not None,
            config,
            guessed=guessed,
        )

    @cached_property
    def origin(self) -> np.ndarray:
        """(3,) the camera's centre in the table frame [m]: where all rays start."""
        return invert_rigid(self.T_camera_table)[:3, 3]

    def origin_of(self, pixels: np.ndarray) -> np.ndarray:
        """Where the rays of pixels (N,) start: (3,), or (N, 3) for several views [m]."""
        return self.origin

    def look(self, points: np.ndarray) -> Sight:
        """What the camera sees on the ray through each point."""
        A, b = self._projection
        return Sight(*sights(*axes_of(points), A, b, self._framed_depth))

    def pixel_of(self, points: np.ndarray) -> np.ndarray:
        """Flat index (N,) int32 of the pixel that sees each point, -1 outside the image."""
        return self.look(points).pixel

    def depth_behind(self, points: np.ndarray) -> np.ndarray:
        """Depth of each point behind the measured surface along z (N,) float32 [m]; NaN where unknown."""
        return self.look(points).behind

    def classify(self, points: np.ndarray) -> np.ndarray:
        """The Region of each point, (N,) int8."""
        return self.classify_axes(*axes_of(points))

    def classify_axes(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """The Region of each point, given axis by axis, (N,) int8."""
        A, b = self._projection
        base, growth = np.float32(self.config.surface_margin), np.float32(2 * self.config.depth_noise)
        lowest = np.float32(self.floor) - base if self.has_support else np.float32(-np.inf)
        return np.asarray(ranks(x, y, z, A, b, self._framed_depth, self._framed_guess, base, growth, lowest))

    @cached_property
    def _framed_depth(self) -> np.ndarray:
        """Depth with a frame of NaN one pixel wide: what falls outside the image is unknown."""
        return np.pad(self.depth.astype(np.float32, copy=False), 1, constant_values=np.float32(np.nan))

    @cached_property
    def _framed_guess(self) -> np.ndarray:
        """Where depth is a guess, framed as depth is; (0, 0) for nowhere."""
        return np.empty((0, 0), bool) if self.guessed is None else np.pad(self.guessed, 1)

    @cached_property
    def _projection(self) -> tuple[np.ndarray, np.ndarray]:
        """A (3, 3) and b (3,) with A x + b = (u z, v z, z), u and v counted in the framed image."""
        # Half a pixel more turns rounding into cutting off, which is faster.
        shift = np.array([[1.0, 0.0, 1.5], [0.0, 1.0, 1.5], [0.0, 0.0, 1.0]])
        P = shift @ self.camera.K @ self.T_camera_table[:3]
        return np.ascontiguousarray(P[:, :3], np.float32), np.ascontiguousarray(P[:, 3], np.float32)


def axes_of(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (N, 3) axis by axis, each in one piece."""
    points = np.asarray(points, np.float32)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points must have shape (N, 3), got {points.shape}")
    x, y, z = np.ascontiguousarray(points.T)
    return x, y, z
