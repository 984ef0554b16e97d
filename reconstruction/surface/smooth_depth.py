"""A depth image as small planes, one a pixel: smoothed along the surfaces it shows, never across an edge.

Noise model: the inverse depth of a pixel has one standard deviation all over the image, as triangulating
sensors (stereo, structured light) have it; depth noise then grows with the square of the depth. It is
measured on the image itself: a depth image without noise stays as it is.

Knows images of depth and labels and a camera; knows nothing of objects or maps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perception.camera import Camera
from perception.grouping import group_by_label

NOISE_QUANTILE = 0.8
"""The noise is read off this quantile of second differences: curved and rough places are in the others."""
GAUSSIAN_AT_QUANTILE = 1.2816
"""What a standard normal's absolute value is below at NOISE_QUANTILE."""
BEND = 3.0
"""A pair of opposite neighbours whose second difference exceeds this many standard deviations lies across an
edge."""
LEAST_BEND = 0.0004
"""Second differences below this are no edges, however little noise there is [m at any depth]."""
SMOOTH_ABOVE = 0.0002
"""With less noise than this [m at the median depth], planes are taken from direct neighbours alone."""
RADIUS = 3
"""Reach of the smoothing [px]."""
ONE_SIDED = 0.02
"""Weight of a neighbour without its opposite: it gives the slope where pairs do not."""
STEPS = ((1, 0), (0, 1))
"""To direct neighbours along u and v [px]."""
NONE = np.float32(-1e4)
"""Inverse depth of pixels without one: so far from any that no difference is small."""
LEVEL = 1e-5
"""Weight of "level" in the slope: decides where no neighbour says anything."""


def surface_planes(
    depth: np.ndarray, labels: np.ndarray, pixels: np.ndarray, camera: Camera
) -> tuple[np.ndarray, float]:
    """Planes (N, 4) float32 [camera frame] through what pixels (N,) see, and the noise at 1 m [m].

    A plane (n, c) has unit normal n away from the camera and n . x = c on it. depth: (H, W) [m], NaN missing;
    labels: (H, W) below 65536: pixels of one label may be one surface; pixels: flat indices of measured
    pixels.
    """
    inverse = (1 / depth).astype(np.float32, copy=False)
    own = inverse.reshape(-1)[pixels]
    parts = [
        _Part.of(inverse, labels, label, pixels[mine], mine)
        for label, mine in group_by_label(labels.reshape(-1)[pixels].astype(np.uint16))
    ]
    bends = np.concatenate(
        [np.empty(0, np.float32), *(part.bends(*step) for part in parts for step in STEPS)]
    )
    noise = _noise(bends)
    middle = float(np.median(own)) if len(own) else 1.0
    radius = RADIUS if noise / middle**2 > SMOOTH_ABOVE else 1
    fitted = np.empty((3, len(pixels)), np.float32)
    for part in parts:
        fitted[:, part.which] = _fitted(part, noise, radius, min(camera.K[0, 0], camera.K[1, 1]))
    smooth, gu, gv = fitted
    row = pixels // camera.width
    u, v = (pixels - row * camera.width).astype(np.float32), row.astype(np.float32)
    # 1 / z = smooth + gu (u - u0) + gv (v - v0) is a plane a . x = 1 of space.
    a = np.stack([gu, gv, smooth - gu * u - gv * v], axis=1) @ camera.K.astype(np.float32)
    length = np.linalg.norm(a, axis=1, keepdims=True)
    return np.concatenate([a / length, 1 / length], axis=1), noise


@dataclass(frozen=True)
class _Part:
    """One label's part of an image, row after row in one piece.

    inverse: float32 inverse depth, NONE where it is not the label's, with a border of RADIUS pixels; width:
    of a row with its border; count: pixels from the first without border to the last; place: (N,) the
    label's pixels, counted from the first one; which: (N,) their places among all.
    """

    inverse: np.ndarray
    width: int
    count: int
    place: np.ndarray
    which: np.ndarray

    @classmethod
    def of(
        cls, inverse: np.ndarray, labels: np.ndarray, label: int, pixels: np.ndarray, which: np.ndarray
    ) -> _Part:
        """inverse, labels: (H, W); pixels: (N,) flat indices of the label's pixels."""
        row = pixels // inverse.shape[1]
        column = pixels - row * inverse.shape[1]
        top, left, bottom, right = row.min(), column.min(), row.max() + 1, column.max() + 1
        part = slice(top, bottom), slice(left, right)
        own = np.full([bottom - top + 2 * RADIUS, right - left + 2 * RADIUS], NONE)
        measured = np.isfinite(inverse[part]) & (labels[part] == label)
        np.copyto(own[RADIUS:-RADIUS, RADIUS:-RADIUS], inverse[part], where=measured)
        width = own.shape[1]
        count = int((bottom - top) * width - 2 * RADIUS)
        return cls(own.reshape(-1), width, count, (row - top) * width + column - left, which)

    def neighbour(self, du: int, dv: int) -> np.ndarray:
        """Inverse depth (count,) of another pixel of the same surface, NONE where there is none."""
        first = (RADIUS + dv) * self.width + RADIUS + du
        return self.inverse[first : first + self.count]

    def bends(self, du: int, dv: int) -> np.ndarray:
        """Absolute second differences (M,) of opposite neighbours."""
        both, own = self.neighbour(du, dv) + self.neighbour(-du, -dv), self.neighbour(0, 0)
        there = (np.minimum(self.neighbour(du, dv), self.neighbour(-du, -dv)) > NONE) & (own > NONE)
        return np.abs(both - 2 * own)[there]


def _fitted(part: _Part, noise: float, radius: int, focal: float) -> np.ndarray:
    """Smoothed inverse depth [1/m] and its slope along u and v [1/m/px] at a part's pixels: (3, N)."""
    own = part.neighbour(0, 0)
    limit = np.float32(BEND * np.sqrt(6) * noise) + np.float32(LEAST_BEND) * own * own
    steps = _half_disc(radius)
    weights, sums, differences = np.empty((3, len(steps), part.count), np.float32)
    for (du, dv), weight, both, difference in zip(steps, weights, sums, differences):
        after, before = part.neighbour(du, dv), part.neighbour(-du, -dv)
        np.add(after, before, out=both)
        pair = np.abs(both - 2 * own) <= limit  # False where one is missing
        np.multiply(pair, np.float32(np.exp(-(du * du + dv * dv) / (2 * (radius / 1.5) ** 2))), out=weight)
        both *= weight
        np.subtract(after, before, out=difference)
        difference *= weight
    u, v = np.array(steps, np.float32).T
    xx, xy, yy, total = np.stack([u * u, u * v, v * v, np.ones_like(u)]) @ weights
    xw, yw = np.stack([u, v]) / 2 @ differences
    xx += np.float32(LEVEL)
    yy += np.float32(LEVEL)
    step_limit = np.float32(4 / focal) * own + np.float32(4 * noise)
    for (du, dv), square, product in zip(STEPS, (xx, yy), (xw, yw)):
        unpaired = weights[steps.index((du, dv))] == 0
        for sign in (1, -1):
            gap = part.neighbour(sign * du, sign * dv) - own
            alone = np.float32(ONE_SIDED) * (unpaired & (np.abs(gap) <= step_limit))
            square += alone
            product += sign * alone * gap
    determinant = xx * yy - xy * xy
    gu, gv = (yy * xw - xy * yw) / determinant, (xx * yw - xy * xw) / determinant
    smooth = (own + sums.sum(0)) / (1 + 2 * total) if radius > 1 else own
    return np.stack([values[part.place] for values in (smooth, gu, gv)])


def _noise(bends: np.ndarray) -> float:
    """Standard deviation of inverse depth [1/m] from absolute second differences (N,) of neighbours."""
    if not len(bends):
        return 0.0
    return float(np.quantile(bends, NOISE_QUANTILE)) / GAUSSIAN_AT_QUANTILE / np.sqrt(6)


def _half_disc(radius: int) -> list[tuple[int, int]]:
    """Steps (du, dv) within a radius [px], one of each opposite pair."""
    reach = radius * radius + 1
    steps = [(u, v) for v in range(radius + 1) for u in range(-radius, radius + 1) if u * u + v * v <= reach]
    return [(u, v) for u, v in steps if v > 0 or u > 0]
