"""What one frame says of space: free, surface, occluded, out of view or below the support, for any points."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from typing import NamedTuple

import numpy as np

from perception.blocks import blocks
from perception.camera import Camera, invert_rigid
from perception.config import PerceptionConfig
from perception.observation import Observation

NEAREST_DEPTH = 1e-4
"""Points nearer to the camera's plane than this, or behind it, have no pixel [m]."""


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

    @property
    def origin(self) -> np.ndarray:
        """(3,) the camera's centre in the table frame [m]: where all rays start."""
        return invert_rigid(self.T_camera_table)[:3, 3]

    def origin_of(self, pixels: np.ndarray) -> np.ndarray:
        """Where the rays of pixels (N,) start: (3,), or (N, 3) for several views [m]."""
        return self.origin

    def look(self, points: np.ndarray) -> Sight:
        """What the camera sees on the ray through each point."""
        points = _checked(points)
        count = len(points)
        sight = Sight(np.empty(count, np.int32), np.empty(count, np.float32), np.empty(count, np.float32))
        width = self.camera.width + 2
        for block in blocks(count):
            pixel, z = self._framed_pixel(points[block])
            np.subtract(z, self._framed_depth.take(pixel), out=sight.behind[block])
            sight.depth[block] = z
            row = pixel // width  # divmod takes several times as long
            column = pixel - row * width
            inside = (row > 0) & (row <= self.camera.height) & (column > 0) & (column <= self.camera.width)
            sight.pixel[block] = np.where(inside, (row - 1) * self.camera.width + column - 1, -1)
        return sight

    def pixel_of(self, points: np.ndarray) -> np.ndarray:
        """Flat index (N,) int32 of the pixel that sees each point, -1 outside the image."""
        return self.look(points).pixel

    def depth_behind(self, points: np.ndarray) -> np.ndarray:
        """Depth of each point behind the measured surface along z (N,) float32 [m]; NaN where unknown."""
        return self.look(points).behind

    def classify(self, points: np.ndarray) -> np.ndarray:
        """The Region of each point, (N,) int8."""
        points = _checked(points)
        result = np.empty(len(points), np.int8)
        base, growth = np.float32(self.config.surface_margin), np.float32(2 * self.config.depth_noise)
        for block in blocks(len(points)):
            pixel, z = self._framed_pixel(points[block])
            measured = self._framed_depth.take(pixel)
            z -= measured
            margin = base + growth * measured * measured
            # FREE, SURFACE, OCCLUDED = 0, 1, 2; all comparisons with NaN are false.
            region = (z >= -margin).view(np.int8) + (z > margin).view(np.int8)
            region[np.isnan(measured)] = Region.OUT_OF_VIEW
            if self._framed_guess is not None:
                region[self._framed_guess.take(pixel) & (region != Region.OCCLUDED)] = Region.OUT_OF_VIEW
            if self.has_support:
                region[points[block, 2] < np.float32(self.floor) - base] = Region.BELOW_SUPPORT
            result[block] = region
        return result

    @cached_property
    def _framed_depth(self) -> np.ndarray:
        """Depth with a frame of NaN one pixel wide, flat: what falls outside the image is unknown."""
        return np.pad(self.depth, 1, constant_values=np.float32(np.nan)).reshape(-1)

    @cached_property
    def _framed_guess(self) -> np.ndarray | None:
        """Where depth is a guess, framed as depth is."""
        return None if self.guessed is None else np.pad(self.guessed, 1).reshape(-1)

    @cached_property
    def _projection(self) -> tuple[np.ndarray, np.ndarray]:
        """A (3, 3) and b (3,) with A x + b = (u z, v z, z), u and v counted in the framed image."""
        # Half a pixel more turns rounding into cutting off, which is faster.
        shift = np.array([[1.0, 0.0, 1.5], [0.0, 1.0, 1.5], [0.0, 0.0, 1.0]])
        P = shift @ self.camera.K @ self.T_camera_table[:3]
        return P[:, :3].astype(np.float32), P[:, 3:].astype(np.float32)

    def _framed_pixel(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Flat index in the framed image (N,) int32, and depth (N,) float32 [m]."""
        A, b = self._projection
        u, v, z = projected = A @ points.T  # (3, N): each row in one piece
        projected += b
        inverse = np.float32(1) / np.maximum(z, np.float32(NEAREST_DEPTH))
        u *= inverse
        v *= inverse
        if z.min(initial=1.0) < NEAREST_DEPTH:
            u[z < NEAREST_DEPTH] = 0
        np.clip(u, 0, self.camera.width + 1, out=u)
        np.clip(v, 0, self.camera.height + 1, out=v)
        pixel = v.astype(np.int32)
        pixel *= np.int32(self.camera.width + 2)
        pixel += u.astype(np.int32)
        return pixel, z


def _checked(points: np.ndarray) -> np.ndarray:
    points = np.asarray(points, np.float32)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points must have shape (N, 3), got {points.shape}")
    return points
