"""A depth image as small planes, one a pixel: smoothed along the surfaces it shows, never across an edge.

Noise model: the inverse depth of a pixel has one standard deviation all over the image, as triangulating
sensors (stereo, structured light) have it; depth noise then grows with the square of the depth. It is
measured on the image itself: a depth image without noise stays as it is.

Knows images of depth and labels and a camera; knows nothing of objects or maps.
"""

from __future__ import annotations

import numpy as np

from perception.camera import Camera

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
LEVEL = 1e-5
"""Weight of "level" in the slope: decides where no neighbour says anything."""


def surface_planes(
    depth: np.ndarray, labels: np.ndarray, pixels: np.ndarray, camera: Camera
) -> tuple[np.ndarray, float]:
    """Planes (N, 4) float32 [camera frame] through what pixels (N,) see, and the noise at 1 m [m].

    A plane (n, c) has unit normal n away from the camera and n . x = c on it. depth: (H, W) [m], NaN missing;
    labels: (H, W): pixels of one label may be one surface; pixels: flat indices of measured pixels.
    """
    width = camera.width
    inverse = np.pad(1 / depth, RADIUS, constant_values=np.nan).astype(np.float32)
    of = np.pad(labels, RADIUS).reshape(-1)
    stride = width + 2 * RADIUS
    inverse = inverse.reshape(-1)
    at = (pixels // width + RADIUS) * stride + pixels % width + RADIUS
    own, label = inverse[at], of[at]

    def neighbour(step: int) -> np.ndarray:
        """Inverse depth (N,) of another pixel of the same surface, NaN where there is none."""
        place = at + step
        return np.where(of[place] == label, inverse[place], np.nan)

    bends = np.concatenate([np.abs(neighbour(s) + neighbour(-s) - 2 * own) for s in (1, stride)])
    bends = bends[np.isfinite(bends)]
    noise = _noise(bends)
    middle = float(np.median(own)) if len(own) else 1.0
    radius = RADIUS if noise / middle**2 > SMOOTH_ABOVE else 1
    limit = BEND * np.sqrt(6) * noise + LEAST_BEND * own * own
    step_limit = 4 * own / min(camera.K[0, 0], camera.K[1, 1]) + 4 * noise
    total, weight = own.copy(), np.ones_like(own)
    xx, xy, yy = (np.full_like(own, value) for value in (LEVEL, 0.0, LEVEL))
    xw, yw = np.zeros_like(own), np.zeros_like(own)
    for du, dv in _half_disc(radius):
        step = dv * stride + du
        after, before = neighbour(step), neighbour(-step)
        pair = np.abs(after + before - 2 * own) <= limit  # False where one is missing
        share = np.float32(np.exp(-(du * du + dv * dv) / (2 * (radius / 1.5) ** 2)))
        both = np.where(pair, share, 0)
        total += both * np.where(pair, after + before, 0)
        weight += 2 * both
        slope = np.where(pair, (after - before) / 2, 0)
        if abs(du) + abs(dv) == 1:
            for value, sign in ((after, 1), (before, -1)):
                gap = value - own
                alone = ~pair & (np.abs(gap) <= step_limit)
                small = np.where(alone, np.float32(ONE_SIDED), 0)
                xx += small * du * du
                yy += small * dv * dv
                xw += small * np.where(alone, gap, 0) * (sign * du)
                yw += small * np.where(alone, gap, 0) * (sign * dv)
        xx += both * (du * du)
        xy += both * (du * dv)
        yy += both * (dv * dv)
        xw += both * slope * du
        yw += both * slope * dv
    determinant = xx * yy - xy * xy
    gu, gv = (yy * xw - xy * yw) / determinant, (xx * yw - xy * xw) / determinant
    smooth = total / weight if radius > 1 else own
    u, v = (pixels % width).astype(np.float32), (pixels // width).astype(np.float32)
    # 1 / z = smooth + gu (u - u0) + gv (v - v0) is a plane a . x = 1 of space.
    a = np.stack([gu, gv, smooth - gu * u - gv * v], axis=1) @ camera.K.astype(np.float32)
    length = np.linalg.norm(a, axis=1, keepdims=True)
    return np.concatenate([a / length, 1 / length], axis=1), noise


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
