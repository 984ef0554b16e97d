"""Whether depth is z along the camera's axis: planes tell it from the ray's length, disparity and z-buffers.

The image of a plane is affine in the pixel for 1 / z, for (length of the ray's direction) / (length of the
ray), and for disparity itself. The largest such region of the image decides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapping.errors import FrameError
from perception.camera import Camera
from perception.checks.label_regions import LabelRegion
from perception.quantiles import quantiles

SAMPLE = 800
"""Pixels looked at."""
TRIALS = 60
"""Planes tried for each kind."""
TOLERANCE = 0.02
"""A pixel lies in the plane within this share of the spread of values."""
LEAST_SHARE = 0.25
"""A plane with a smaller share of the pixels decides nothing."""
BETTER = 2.5
"""The other kind must fit this many times better on its own plane ..."""
FLAT = 0.04
"""... to this share of the spread ..."""
RIVAL = 0.75
"""... and z must have no plane with this share of its pixels that fits as well."""
BENDS = 0.1
"""A plane whose depth changes by a smaller share is as flat in z as in its inverse: it tells them not
apart."""
WORDS = {
    "ray": (
        "the length of the ray, not z along the camera's axis",
        'set "depth_kind": "ray" in the camera file, or multiply depth by the cosine of each ray',
    ),
    "inverse": (
        "disparity or a z-buffer, not metres",
        "convert it: z = focal length x baseline / disparity, or z = near far / (far - buffer (far - near))",
    ),
}
BUFFER_LEAST = 0.8
"""Values of a z-buffer lie between this and 1."""
BUFFER_PIXELS = 20
"""So many pixels hold exactly 1, where nothing was drawn."""
RELIEF = 0.1
"""In a z-buffer things are flat: less deep than this share of their length."""
PAPER = 0.02
"""Flatter than this no sensor sees them."""


@dataclass(frozen=True)
class Fit:
    """The largest plane under one kind. inside: (N,) bool; error: its residual as a share of its spread."""

    inside: np.ndarray
    error: float


def check_depth_kind(
    depth: np.ndarray, camera: Camera, source: str, rng: np.random.Generator, trusted: bool
) -> None:
    """Raise FrameError when depth (H, W) [m] is the ray's length, disparity or a z-buffer; see the module."""
    if trusted:
        return
    if np.count_nonzero(depth == 1) > BUFFER_PIXELS and np.nanmax(depth) == 1:
        nearest = float(np.nanmin(depth))
        if nearest > BUFFER_LEAST:
            raise FrameError(
                f"{source}: depth ends at exactly 1 and begins at {nearest:.3g}: {_sentence('inverse')}"
            )
    measured = np.flatnonzero(np.isfinite(depth))
    if len(measured) > SAMPLE:
        measured = measured[rng.integers(len(measured), size=SAMPLE)]  # a pixel twice does no harm
    if len(measured) < 200:
        return
    value = depth.reshape(-1)[measured].astype(np.float64)
    row, column = np.divmod(measured, camera.width)
    pixel = np.stack([column / camera.width, row / camera.height, np.ones(len(row))], 1)
    length = np.linalg.norm(camera.rays.reshape(-1, 3)[measured], axis=1)
    straight = 1 / value
    plain = _largest_plane(pixel, straight, rng)
    for kind, other in (("ray", length / value), ("inverse", value)):
        fit = _largest_plane(pixel, other, rng)
        if fit.inside.mean() < LEAST_SHARE or fit.error > FLAT:
            continue
        low, high = quantiles(value[fit.inside], 0.05, 0.95)
        if kind == "inverse" and high < (1 + BENDS) * low:
            continue
        bent = _error(pixel[fit.inside], straight[fit.inside])
        rival = plain.inside.sum() > RIVAL * fit.inside.sum() and plain.error < BETTER * fit.error
        if bent > BETTER * fit.error and not rival:
            raise FrameError(
                f'{source}: depth looks like {_sentence(kind)}; if it is z, add "trust": ["kind"]'
            )


def check_buffer(depth: np.ndarray, regions: list[LabelRegion], source: str, trusted: bool) -> list[str]:
    """A note where depth (H, W) [m] could be a z-buffer: all of it just under 1, and all things flat.

    Raises FrameError when they are flatter than any sensor would show them.
    """
    if trusted or not regions or np.nanmax(depth) >= 1 or np.nanquantile(depth, 0.02) < BUFFER_LEAST:
        return []
    relief = float(np.median([item.sides[2] / item.sides[0] for item in regions]))
    if relief > RELIEF:
        return []
    text = (
        f"all depth lies between {np.nanmin(depth):.3g} and {np.nanmax(depth):.3g} and things are flat: a "
        "z-buffer? Then z = near far / (far - buffer (far - near))"
    )
    if relief < PAPER:
        raise FrameError(f'{source}: {text}; if it is z in metres, add "trust": ["kind"]')
    return [text]


def _sentence(kind: str) -> str:
    return f"{WORDS[kind][0]} (planes are bent as z, flat so); {WORDS[kind][1]}"


def _largest_plane(pixel: np.ndarray, values: np.ndarray, rng: np.random.Generator) -> Fit:
    """The largest set of pixels on which values (N,) are affine in pixel (N, 3)."""
    low, high = quantiles(values, 0.1, 0.9)
    scaled = (values - low) / max(high - low, 1e-9)
    picks = pixel[(chosen := rng.integers(len(values), size=(TRIALS, 3)))]
    solvable = np.abs(np.linalg.det(picks)) > 1e-3
    if not solvable.any():
        return Fit(np.zeros(len(values), bool), np.inf)
    planes = np.linalg.solve(picks[solvable], scaled[chosen[solvable]][..., None])[..., 0]
    count = np.count_nonzero(np.abs(planes @ pixel.T - scaled) < TOLERANCE, axis=1)
    plane = planes[int(np.argmax(count))]
    inside = np.abs(pixel @ plane - scaled) < TOLERANCE
    for _ in range(3):
        plane = _affine(pixel[inside], scaled[inside])
        residual = np.abs(pixel @ plane - scaled)
        inside = residual < TOLERANCE
        if inside.sum() < 10:
            return Fit(inside, np.inf)
    return Fit(inside, _error(pixel[inside], scaled[inside]))


def _error(pixel: np.ndarray, values: np.ndarray) -> float:
    """Residual of the best plane as a share of the values' spread, both as robust standard deviations."""
    plane = _affine(pixel, values)
    spread = float(values.std())
    return float(np.sqrt(np.mean((pixel @ plane - values) ** 2)) / max(spread, 1e-12))


def _affine(pixel: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The coefficients (3,) with which pixel (N, 3) gives values (N,) best, by the normal equations."""
    return np.linalg.lstsq(pixel.T @ pixel, pixel.T @ values, rcond=None)[0]
