"""A depth image as small planes, one a pixel: smoothed along the surfaces it shows, never across an edge.

Noise model: the inverse depth of a pixel has one standard deviation all over the image, as triangulating
sensors (stereo, structured light) have it; depth noise then grows with the square of the depth. It is
measured on the image itself: a depth image without noise stays as it is.

Knows images of depth and labels and a camera; knows nothing of objects or maps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapping.compiled import compiled
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
LEVEL = np.float32(1e-5)
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
    focal = min(camera.K[0, 0], camera.K[1, 1])
    for part in parts:
        fitted[:, part.which] = _fitted(part, noise, radius, focal)
    planes, K = np.empty((len(pixels), 4), np.float32), camera.K.astype(np.float32)
    _in_space(fitted, pixels, camera.width, K, planes)
    return planes, noise


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
    steps = np.array(_half_disc(radius))
    weights = np.exp(-(steps**2).sum(1) / (2 * (radius / 1.5) ** 2)).astype(np.float32)
    places = part.place + RADIUS * (part.width + 1)
    bend = np.float32(BEND * np.sqrt(6) * noise)
    near = np.float32(4 / focal), np.float32(4 * noise)
    return _planes(part.inverse, part.width, places, steps, weights, bend, *near, radius > 1)


@compiled
def _planes(
    inverse: np.ndarray,
    width: int,
    places: np.ndarray,
    steps: np.ndarray,
    weights: np.ndarray,
    bend: float,
    per_pixel: float,
    spread: float,
    smoothed: bool,
) -> np.ndarray:
    """Smoothed inverse depth and its slopes along u and v (3, N) at places (N,) of a part's rows.

    From opposite neighbours, `steps` (S, 2) away and of weights (S,), (1, 0) and (0, 1) among them; a pair
    that bends by more than `bend` [1/m] of noise does not count. A neighbour without its opposite, where
    there is no direct pair along u or v, counts if it is nearer than `per_pixel` times the inverse depth and
    `spread` [1/m].
    """
    found = np.empty((3, len(places)), np.float32)
    zero, half, share = np.float32(0), np.float32(0.5), np.float32(ONE_SIDED)
    for n in range(len(places)):
        place = places[n]
        own = inverse[place]
        most = bend + np.float32(LEAST_BEND) * own * own
        xx = yy = LEVEL
        xy = xw = yw = count = total = zero
        alone_u = alone_v = True
        for s in range(len(steps)):
            step = steps[s, 1] * width + steps[s, 0]
            after, before = inverse[place + step], inverse[place - step]
            both = after + before
            # Never where one is missing.
            if abs(both - np.float32(2) * own) <= most:
                u, v, weight = np.float32(steps[s, 0]), np.float32(steps[s, 1]), weights[s]
                difference = half * weight * (after - before)
                xx += weight * u * u
                xy += weight * u * v
                yy += weight * v * v
                xw += difference * u
                yw += difference * v
                count += weight
                total += weight * both
                alone_u &= not (steps[s, 0] == 1 and steps[s, 1] == 0)
                alone_v &= not (steps[s, 0] == 0 and steps[s, 1] == 1)
        for sign in (1, -1):
            gap = inverse[place + sign] - own
            if alone_u and abs(gap) <= per_pixel * own + spread:
                xx += share
                xw += np.float32(sign) * share * gap
            gap = inverse[place + sign * width] - own
            if alone_v and abs(gap) <= per_pixel * own + spread:
                yy += share
                yw += np.float32(sign) * share * gap
        determinant = xx * yy - xy * xy
        found[0, n] = (own + total) / (np.float32(1) + np.float32(2) * count) if smoothed else own
        found[1, n] = (yy * xw - xy * yw) / determinant
        found[2, n] = (xx * yw - xy * xw) / determinant
    return found


@compiled
def _in_space(smooth: np.ndarray, pixels: np.ndarray, width: int, K: np.ndarray, planes: np.ndarray) -> None:
    """Fill planes (N, 4) of pixels (N,) from inverse depth and its slopes (3, N) there: 1 / z = smooth +
    gu (u - u0) + gv (v - v0) is a plane a . x = 1 of space."""
    for n in range(len(pixels)):
        row = pixels[n] // width
        u, v = np.float32(pixels[n] - row * width), np.float32(row)
        gu, gv = smooth[1, n], smooth[2, n]
        constant = smooth[0, n] - gu * u - gv * v
        x = gu * K[0, 0] + gv * K[1, 0] + constant * K[2, 0]
        y = gu * K[0, 1] + gv * K[1, 1] + constant * K[2, 1]
        z = gu * K[0, 2] + gv * K[1, 2] + constant * K[2, 2]
        length = np.sqrt(x * x + y * y + z * z)
        planes[n, 0], planes[n, 1], planes[n, 2] = x / length, y / length, z / length
        planes[n, 3] = np.float32(1) / length


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
