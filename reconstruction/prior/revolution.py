"""What a frame says of an object if it were a body of revolution: evidence turned about a vertical axis.

Cups, bowls, bottles and pots are; their far wall and their cavity are known from the near wall and the rim.
The axis comes from circles fitted to level slices of the visible points. Whether the object is such a body is
left to the network to judge, from how well the circles fit and how often the turned evidence contradicts
itself. `reconstruction/surface/vertical_axis.py` knows normals and finds the axis better; this one stays what
the weights were trained with.
Knows rays and visible points; knows nothing of images and weights.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from reconstruction.prior.features import OWN, ObjectBox, RayEvidence

SLICES = 12
"""Level slices of the visible points, each with circles of its own about the common axis."""
PROFILE_POINTS, FIT_POINTS = 3000, 500
"""About as many visible points are used for the profile, and for the axis."""
ROUNDS = 3
"""Fits: each tells better which points lie before the axis (outer wall) and which behind it (inner wall)."""
PULL = 0.02
"""Weight of the first guess, as a share of the points' spread across the view: thin arcs say little."""
RADII, LEVELS, ANGLES = 24, 16, 8
"""Cells of the table from the axis outwards and upwards, and places around the axis that are looked at."""
REACH = 0.75
"""The table reaches this share of the box's side from the axis."""
PROFILE = 64
"""Cells along radius and height of the picture of the visible points turned into one half plane."""
PASSED = 0.003
"""A ray has passed through a place that lies this far before what it measured [m]."""
REVOLUTION_NAMES = (
    "turned_free_share",
    "turned_behind_8mm",
    "turned_behind_40mm",
    "turned_own_share",
    "profile_distance_4mm",
    "profile_distance_15mm",
    "radius_over_side",
    "circle_misfit",
)
REVOLUTION_CHANNELS = len(REVOLUTION_NAMES)


@dataclass(frozen=True)
class Revolution:
    """Turned evidence of one object.

    axis: (2,) where the vertical axis meets the plane, in the box's turned frame [m]; misfit: spread of the
    radii of one wall in one slice, relative to the visible width; table: (3, RADII, LEVELS) float32: share of
    the places at that radius and height that rays passed through, second smallest depth behind the first
    surface [m], share behind the object itself; profile: (PROFILE, PROFILE) float32 distance [m] to the
    nearest visible point turned into the half plane of radius and height.
    """

    axis: np.ndarray
    misfit: float
    table: np.ndarray
    profile: np.ndarray

    @classmethod
    def of(
        cls, box: ObjectBox, visible: np.ndarray, evidence: Callable[[np.ndarray], RayEvidence]
    ) -> Revolution:
        """Turned evidence of visible points (M, 3); evidence(points (N, 3)) of its rays; table frame."""
        turned = box.turned(_thinned(visible, PROFILE_POINTS))
        axis, misfit = vertical_axis(_thinned(turned, FIT_POINTS), box)
        return cls(axis, misfit, _table(box, axis, evidence), _profile(box, axis, turned))

    def channels(self, box: ObjectBox, local: np.ndarray) -> np.ndarray:
        """Feature rows (REVOLUTION_CHANNELS, N) float32 at points (N, 3) in box coordinates."""
        x, y, z = local.T
        half = np.float32(box.size[0] / 2)
        shift = ((self.axis - box.low[:2]) / half - 1).astype(np.float32)
        radius = np.hypot(x - shift[0], y - shift[1]) * half
        out = radius * np.float32(2 / (REACH * box.size[0])) - 1
        free, behind, own = _between(self.table, out, z)
        across, up = _profile_cell(box, radius), _profile_cell(box, (z + 1) * np.float32(box.size[2] / 2))
        near = self.profile.take(across * PROFILE + up)
        rows = np.empty((REVOLUTION_CHANNELS, len(local)), np.float32)
        rows[0] = free
        np.clip(behind / np.float32(0.008), -1, 1, out=rows[1])
        np.clip(behind / np.float32(0.04), -1, 1, out=rows[2])
        rows[3] = own
        np.clip(1 - near / np.float32(0.004), -1, 1, out=rows[4])
        np.clip(1 - near / np.float32(0.015), -1, 1, out=rows[5])
        rows[6] = radius / (2 * half)
        rows[7] = min(10 * self.misfit, 1.0)
        return rows


def vertical_axis(turned: np.ndarray, box: ObjectBox) -> tuple[np.ndarray, float]:
    """Where the axis (2,) of a body of revolution would stand, and how badly its circles fit.

    turned: visible points (M, 3) in the box's turned frame [m]. The circles of all slices share their centre,
    so that |p|^2 less its mean in a slice is linear in the centre: two equations, whatever the radii.
    """
    x, y, z = turned.T.astype(np.float64)
    width = max(float(np.ptp(y)), 1e-3)
    guess = np.array([x.min() + width / 2, (y.min() + y.max()) / 2])
    dx, dy = x - guess[0], y - guess[1]
    square = dx * dx + dy * dy
    span = max(box.top - box.bottom, 0.005)
    level = np.clip(((z - box.bottom) / span * SLICES).astype(int), 0, SLICES - 1)
    pull = PULL * len(x) * width**2 * np.eye(2)
    centre: np.ndarray = np.zeros(2)
    for _ in range(ROUNDS):
        wall = 2 * level + (dx > centre[0])
        a, b, c = (_less_mean(column, wall) for column in (dx, dy, square))
        normal = np.array([[a @ a, a @ b], [a @ b, b @ b]])
        centre = np.linalg.solve(normal + pull, np.array([a @ c, b @ c]) / 2)
        centre = np.clip(centre, -width / 2, width / 2)
    wall = 2 * level + (dx > centre[0])
    radius = np.hypot(dx - centre[0], dy - centre[1])
    misfit = float(np.sqrt(np.mean(_less_mean(radius, wall) ** 2)) / width)
    return guess + centre, misfit


def _thinned(points: np.ndarray, most: int) -> np.ndarray:
    return points[:: max(1, len(points) // most)]


def _less_mean(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    total = np.bincount(group, values, 2 * SLICES)
    count = np.maximum(np.bincount(group, minlength=2 * SLICES), 1)
    return values - (total / count)[group]


def _table(box: ObjectBox, axis: np.ndarray, evidence: Callable) -> np.ndarray:
    radius = ((np.arange(RADII) + 0.5) * (REACH * box.size[0] / RADII)).astype(np.float32)
    height = (box.low[2] + box.size[2] * (np.arange(LEVELS) + 0.5) / LEVELS).astype(np.float32)
    angle = (np.arange(ANGLES) + 0.5) * (2 * np.pi / ANGLES)
    points = np.empty((3, ANGLES, RADII, LEVELS), np.float32)
    points[0] = (axis[0] + np.cos(angle)[:, None] * radius)[..., None]
    points[1] = (axis[1] + np.sin(angle)[:, None] * radius)[..., None]
    points[2] = height
    seen = evidence(box.back(points.reshape(3, -1).T))
    behind = seen.behind.reshape(ANGLES, RADII, LEVELS)
    known = np.isfinite(behind)
    count = np.maximum(known.sum(0), 1)
    # Where nothing was measured a place counts as far behind: it says nothing against the object.
    smallest = np.partition(np.where(known, behind, np.float32(1.0)), 1, axis=0)[1]
    passed = (behind < -PASSED).sum(0) / count
    own = ((seen.seen.reshape(behind.shape) == OWN) & (behind > -PASSED)).sum(0) / ANGLES
    return np.stack([passed, smallest, own]).astype(np.float32)


def _between(table: np.ndarray, out: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Values (3, N) of a table (3, RADII, LEVELS) between its cells, at places (N,) from -1 to 1 outwards and
    upwards; beyond its ends, the nearest cells count."""
    shares, firsts = [], []
    for place, count in ((out, RADII), (up, LEVELS)):
        at = np.clip((place + 1) * np.float32(count / 2) - np.float32(0.5), 0, count - 1)
        first = np.minimum(at.astype(np.int32), count - 2)
        firsts.append(first)
        shares.append(at - first)
    (r, z), (dr, dz) = firsts, shares
    index = r * np.int32(LEVELS) + z
    columns = table.reshape(3, -1)
    low, high = (
        columns.take(index + step, axis=1) * (1 - dz) + columns.take(index + step + 1, axis=1) * dz
        for step in (0, LEVELS)
    )
    return low * (1 - dr) + high * dr


def _profile(box: ObjectBox, axis: np.ndarray, turned: np.ndarray) -> np.ndarray:
    radius = np.hypot(turned[:, 0] - np.float32(axis[0]), turned[:, 1] - np.float32(axis[1]))
    empty = np.ones((PROFILE, PROFILE), np.uint8)
    empty[_profile_cell(box, radius), _profile_cell(box, turned[:, 2] - np.float32(box.low[2]))] = 0
    return cv2.distanceTransform(empty, cv2.DIST_L2, 3) * np.float32(_profile_side(box))


def _profile_side(box: ObjectBox) -> float:
    """Side of the profile's square cells [m]."""
    return float(max(REACH * box.size[0], box.size[2]) / PROFILE)


def _profile_cell(box: ObjectBox, length: np.ndarray) -> np.ndarray:
    cell = (length * np.float32(1 / _profile_side(box))).astype(np.int32)
    return np.clip(cell, 0, PROFILE - 1, out=cell)
