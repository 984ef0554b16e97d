"""What the occlusion prior looks at: one object's surroundings as a small lattice, and the same at any point.

Works in a table frame: z along the support plane's normal, z = 0 on the plane. Knows rays and visible points,
nothing of cameras and images. Everything is expressed relative to the viewing direction and to the visible
extent, so that turning the table or the camera about the vertical changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

LATTICE = (24, 24, 16)
"""Cells of an object's box along the view, across it, and upwards."""
ROOM = (1.6, 0.2, 0.02)
"""Side of the box: multiple of the visible width, plus share of the visible height, plus length [m]."""
BACKWARD_SHIFT = 0.10
"""The visible surface lies this share of the side before the box's middle: what is hidden lies behind."""
ROOM_ABOVE = (0.08, 0.004)
"""Room above the visible top: share of the height and length [m]."""
ROOM_BELOW = (0.5, 0.02)
"""Room under the visible bottom, down to the support plane at most: share of the height and length [m]."""
LEAST_HEIGHT = 0.02
"""A box is at least this high [m]."""

OWN, BACKGROUND, OTHER, UNKNOWN = 0, 1, 2, 3
"""What the ray through a point sees: the object itself, no object, another object, nothing measured."""

RAY_NAMES = (
    "behind_8mm",
    "behind_40mm",
    "behind_over_side",
    "sees_own",
    "sees_other",
    "sees_nothing",
    "border_15mm",
    "border_over_side",
    "x",
    "y",
    "z",
    "height_40mm",
    "depth_under_top",
    "log_side",
    "log_height",
    "slope",
    "behind_3mm",
    "height_10mm",
)
"""What each row of `channels` says."""
RAY_CHANNELS = len(RAY_NAMES)
LATTICE_CHANNELS = RAY_CHANNELS + 1


class RayEvidence(NamedTuple):
    """What the rays through N points say, for one object.

    behind: (N,) depth behind the first surface on the ray [m], negative before it, NaN where unknown;
    seen: (N,) int8 of OWN, BACKGROUND, OTHER, UNKNOWN; inside: (N,) distance from the ray to the border of
    the object's visible region [m], positive inside it.
    """

    behind: np.ndarray
    seen: np.ndarray
    inside: np.ndarray


Evidence = Callable[[np.ndarray, int], RayEvidence]
"""evidence(points (N, 3), object index) of one frame."""


@dataclass(frozen=True)
class ObjectBox:
    """The box around one object that the prior looks at: turned about z so that x points away from the eye.

    heading: (2,) unit vector of x; low: (3,) lower corner in the turned frame [m]; size: (3,) sides [m], the
    first two equal; bottom, top: heights of the visible points [m]; slope: how steeply the eye looks down.
    """

    heading: np.ndarray
    low: np.ndarray
    size: np.ndarray
    bottom: float
    top: float
    slope: float

    @classmethod
    def around(cls, visible: np.ndarray, origin: np.ndarray) -> ObjectBox:
        """The box for visible points (M, 3) seen from origin (3,), both in the table frame."""
        # Column by column: reducing rows of three is slow.
        middle = np.array([column.mean(dtype=np.float64) for column in visible.T])
        view = middle - origin
        level = float(np.hypot(*view[:2]))
        heading = view[:2] / level if level > 1e-6 else np.array([1.0, 0.0])
        turned = _turn(visible, heading).T
        lowest, highest = turned.min(1).astype(float), turned.max(1).astype(float)
        extent = highest - lowest
        height = extent[2]
        side = ROOM[0] * max(extent[:2]) + ROOM[1] * height + ROOM[2]
        centre = (lowest[:2] + highest[:2]) / 2 + [BACKWARD_SHIFT * side, 0.0]
        floor = max(0.0, lowest[2] - ROOM_BELOW[0] * height - ROOM_BELOW[1])
        ceiling = highest[2] + ROOM_ABOVE[0] * (highest[2] - floor) + ROOM_ABOVE[1]
        return cls(
            heading=heading,
            low=np.array([*(centre - side / 2), floor]),
            size=np.array([side, side, max(ceiling - floor, LEAST_HEIGHT)]),
            bottom=float(lowest[2]),
            top=float(highest[2]),
            slope=float(-view[2] / max(level, 1e-6)),
        )

    def turned(self, points: np.ndarray) -> np.ndarray:
        """Points (N, 3) float32 turned so that x points away from the eye [m]."""
        return _turn(points, self.heading)

    def back(self, turned: np.ndarray) -> np.ndarray:
        """The reverse of `turned`."""
        return _turn(turned, self.heading * [1, -1])

    def local(self, points: np.ndarray) -> np.ndarray:
        """Points (N, 3) float32 of the table frame in box coordinates, -1 to 1 along each axis."""
        scale = (2 / self.size).astype(np.float32)
        axes = _turn(points, self.heading).T
        axes *= scale[:, None]
        axes -= (1 + self.low * scale).astype(np.float32)[:, None]
        return axes.T

    def lattice(self) -> np.ndarray:
        """Cell centres (V, 3) float32 in the table frame, z fastest."""
        x, y, z = (
            (low + size / cells * (np.arange(cells) + 0.5)).astype(np.float32)
            for low, size, cells in zip(self.low, self.size, LATTICE)
        )
        axes = np.empty((3, *LATTICE), np.float32)
        # All heights are turned alike, so one layer is turned and repeated.
        layer = np.stack([np.repeat(x, len(y)), np.tile(y, len(x)), np.zeros(len(x) * len(y))], axis=1)
        turned = _turn(layer.astype(np.float32), self.heading * [1, -1])
        axes[:2] = turned.T[:2].reshape(2, len(x), len(y), 1)
        axes[2] = z
        return axes.reshape(3, -1).T

    def surface_cells(self, visible: np.ndarray) -> np.ndarray:
        """(V,) bool: lattice cells that hold visible points (M, 3)."""
        size = np.array(LATTICE, np.float32)[:, None]
        cell = np.floor((self.local(visible).T + 1) / 2 * size).astype(np.int32)
        held = np.zeros(LATTICE, bool)
        held[tuple(np.clip(cell, 0, size.astype(np.int32) - 1))] = True
        return held.reshape(-1)

    def scalars(self) -> np.ndarray:
        """(6,) float32: side and height of the box, floor, visible bottom and top [m], slope."""
        values = [self.size[0], self.size[2], self.low[2], self.bottom, self.top, self.slope]
        return np.array(values, np.float32)


def channels(local: np.ndarray, evidence: RayEvidence, scalars: np.ndarray) -> np.ndarray:
    """Feature rows (RAY_CHANNELS, N) float32 of points in box coordinates (N, 3).

    scalars: (6, 1) of one box, or (6, N) with the box of each point.
    """
    side, height, floor, bottom, top, slope = scalars
    behind = evidence.behind.astype(np.float32)
    behind[np.isnan(behind)] = 0
    inside = evidence.inside.astype(np.float32)
    z = floor + (local[:, 2] + 1) / 2 * height
    span = np.maximum(top - bottom, 0.005)
    rows = np.empty((RAY_CHANNELS, len(local)), np.float32)  # filled in place: this is asked often
    np.divide(behind, np.float32(0.008), out=rows[0])
    np.divide(behind, np.float32(0.04), out=rows[1])
    np.divide(behind, side, out=rows[2])
    for row, kind in enumerate((OWN, OTHER, UNKNOWN), 3):
        rows[row] = evidence.seen == kind
    np.divide(inside, np.float32(0.015), out=rows[6])
    np.divide(4 * inside, side, out=rows[7])
    rows[8:11] = local.T
    np.clip(z / np.float32(0.04), 0, 1, out=rows[11])
    np.clip((top - z) / span, -1, 2, out=rows[12])
    rows[13] = np.log(side / 0.15)
    rows[14] = np.log(height / 0.1)
    rows[15] = np.clip(slope, 0, 3)
    np.divide(behind, np.float32(0.003), out=rows[16])
    np.clip(z / np.float32(0.01), 0, 1, out=rows[17])
    for lengths in (rows[:3], rows[6:8], rows[16]):
        np.clip(lengths, -1, 1, out=lengths)
    return rows


def _turn(points: np.ndarray, heading: np.ndarray) -> np.ndarray:
    """Points (N, 3) float32 turned about z so that `heading` (2,) becomes x; each axis in one piece."""
    c, s = np.float32(heading[0]), np.float32(heading[1])
    x, y, z = points.T
    turned = np.empty((3, len(points)), np.float32)
    np.add(c * x, s * y, out=turned[0])
    np.subtract(c * y, s * x, out=turned[1])
    turned[2] = z
    return turned.T
