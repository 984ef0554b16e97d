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
COLUMNS = 16
"""Matrix products of a multiple of this sum all columns in one order."""
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
    steps = np.array(_half_disc(radius))
    weights = np.exp(-(steps**2).sum(1) / (2 * (radius / 1.5) ** 2)).astype(np.float32)
    places = part.place + RADIUS * (part.width + 1)
    bend = np.float32(BEND * np.sqrt(6) * noise)
    shares, differences, sums = _pairs(part.inverse, part.width, places, steps, weights, bend)
    u, v = steps.T.astype(np.float32)
    moments = np.stack([u * u, u * v, v * v, np.ones_like(u)]) @ shares
    slopes = np.stack([u, v]) / 2 @ differences
    alone = shares[steps.tolist().index([1, 0])] == 0, shares[steps.tolist().index([0, 1])] == 0
    per_pixel, spread = np.float32(4 / focal), np.float32(4 * noise)
    fit = _fit(part.inverse, part.width, places, moments, slopes, *alone, per_pixel, spread)
    own = part.inverse[places]
    return np.stack([(own + sums) / (1 + 2 * moments[3, : len(own)]) if radius > 1 else own, *fit])


@compiled
def _pairs(
    inverse: np.ndarray, width: int, places: np.ndarray, steps: np.ndarray, weights: np.ndarray, bend: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What opposite neighbours, `steps` (S, 2) away from places (N,) of a part's rows, say of the surface.

    The weight of each pair (S, M), 0 where it bends by more than `bend` [1/m] of noise; its difference
    (S, M), and the sum of all pairs (N,), both times that. M: N and a few more.
    """
    count = len(places)
    shares = np.zeros((len(steps), count + -count % COLUMNS), np.float32)
    differences, sums = np.zeros_like(shares), np.zeros(count, np.float32)
    for s in range(len(steps)):
        step, weight = steps[s, 1] * width + steps[s, 0], weights[s]
        for n in range(count):
            own, after = inverse[places[n]], inverse[places[n] + step]
            before = inverse[places[n] - step]
            both = after + before
            # Never where one is missing.
            if abs(both - np.float32(2) * own) <= bend + np.float32(LEAST_BEND) * own * own:
                shares[s, n], differences[s, n] = weight, weight * (after - before)
                sums[n] += weight * both
    return shares, differences, sums


@compiled
def _fit(
    inverse: np.ndarray,
    width: int,
    places: np.ndarray,
    moments: np.ndarray,
    slopes: np.ndarray,
    alone_u: np.ndarray,
    alone_v: np.ndarray,
    per_pixel: float,
    spread: float,
) -> np.ndarray:
    """The slopes (2, N) at places (N,) of a part's rows, from the sums over pairs: of weights times u u, u v,
    v v, 1 (4, M) and of differences times u, v (2, M).

    A neighbour without its opposite, where there is no pair along u or v (M,), counts if it is nearer than
    `per_pixel` times the inverse depth and `spread` [1/m].
    """
    found = np.empty((2, len(places)), np.float32)
    share = np.float32(ONE_SIDED)
    for n in range(len(places)):
        own = inverse[places[n]]
        xx, xy, yy = moments[0, n] + np.float32(LEVEL), moments[1, n], moments[2, n] + np.float32(LEVEL)
        xw, yw = slopes[0, n], slopes[1, n]
        for sign in (1, -1):
            gap = inverse[places[n] + sign] - own
            if alone_u[n] and abs(gap) <= per_pixel * own + spread:
                xx += share
                xw += np.float32(sign) * share * gap
            gap = inverse[places[n] + sign * width] - own
            if alone_v[n] and abs(gap) <= per_pixel * own + spread:
                yy += share
                yw += np.float32(sign) * share * gap
        determinant = xx * yy - xy * xy
        found[0, n] = (yy * xw - xy * yw) / determinant
        found[1, n] = (xx * yw - xy * xw) / determinant
    return found


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
