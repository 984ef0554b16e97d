"""What a real depth camera and a real segmentation get wrong, added to a perfect frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from perception.camera import Camera


@dataclass(frozen=True)
class SensorNoiseConfig:
    """Errors of a structured-light or stereo depth camera."""

    axial: float = 0.0012
    """Standard deviation of depth at 1 m [m]; it grows with the square of depth."""
    correlation_px: float = 1.0
    """Neighbouring pixels share their error over about this distance."""
    disparity_step: float = 0.0015
    """Step between the depths that can be told apart at 1 m [m]; it grows with the square of depth."""
    grazing_deg: float = 75.0
    """Surfaces seen at more than this angle from their normal start to lose their depth."""
    edge_jump_m: float = 0.02
    """Neighbouring depths that differ by more than this make an edge."""
    edge_holes: float = 0.25
    """Share of edge pixels without depth."""
    flying: float = 0.25
    """Share of edge pixels whose depth lies between foreground and background."""
    waves: float = 0.0
    """Standard deviation at 1 m [m] of a smooth error over patches of `waves_px`; grows as axial does."""
    waves_px: int = 24
    """Size of the patches of smooth error."""
    rounding_px: float = 0.0
    """Creases are smoothed over about this distance, as matching windows do; depth edges stay."""
    shadow_m: float = 0.0
    """Distance of the second imager, to the right; left of it when negative. What it cannot see is lost."""


@dataclass(frozen=True)
class LabelNoiseConfig:
    """Errors of a learned instance segmentation."""

    border_px: int = 3
    """Masks grow or shrink by up to this many pixels."""
    leak: float = 0.3
    """Share of objects whose mask leaks over its border."""
    leak_px: tuple[int, int] = (5, 14)
    """Smallest and largest radius of a leak."""


def noisy_depth(
    depth: np.ndarray, camera: Camera, rng: np.random.Generator, config: SensorNoiseConfig | None = None
) -> np.ndarray:
    """Depth (H, W) [m] as a sensor would measure it; lost pixels are NaN."""
    config = config or SensorNoiseConfig()
    cosine = viewing_cosine(depth, camera)
    edge, near, far = _edges(depth, config.edge_jump_m)
    roll = rng.random(depth.shape)
    share = rng.random(depth.shape)
    flying = edge & (roll < config.flying)
    measured = np.where(flying, near + share * (far - near), depth)
    if config.rounding_px > 0:
        measured = np.where(flying, measured, _rounded(depth, config))

    noise = rng.standard_normal(depth.shape)
    if config.correlation_px > 0:
        noise = ndimage.gaussian_filter(noise, config.correlation_px)
        noise *= 2 * np.sqrt(np.pi) * config.correlation_px  # back to unit variance
    measured = measured + config.axial * measured**2 * noise
    if config.waves > 0:
        measured = measured + config.waves * measured**2 * _smooth_noise(depth.shape, config.waves_px, rng)
    # A camera tells disparities apart, not depths: the step in 1 / z is constant.
    inverse = np.rint(1 / measured / config.disparity_step) * config.disparity_step
    with np.errstate(divide="ignore", invalid="ignore"):
        measured = np.where(inverse > 0, 1 / inverse, np.nan)

    limit = np.cos(np.deg2rad(config.grazing_deg))
    lost = rng.random(depth.shape) > cosine / limit  # surely lost where the surface is seen edge-on
    lost |= edge & ~flying & (roll > 1 - config.edge_holes)
    if config.shadow_m:
        lost |= in_stereo_shadow(depth, camera, config.shadow_m)
    return np.where(lost, np.nan, measured).astype(np.float32)


def in_stereo_shadow(depth: np.ndarray, camera: Camera, baseline: float) -> np.ndarray:
    """Pixels (H, W) bool that a second imager, `baseline` metres to the right, sees something else before."""
    if baseline < 0:
        return in_stereo_shadow(depth[:, ::-1], camera, -baseline)[:, ::-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        disparity = np.nan_to_num(camera.K[0, 0] * baseline / depth, nan=0.0)
    column = np.arange(depth.shape[1]) - disparity  # where the second imager sees it
    # Something further right that it sees further left, or at the same place, hides it.
    nearest = np.minimum.accumulate(column[:, ::-1], axis=1)[:, ::-1]
    return np.append(nearest[:, 1:], np.full((len(depth), 1), np.inf), axis=1) < column


def viewing_cosine(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """Cosine (H, W) of the angle between the surface normal and the ray to the camera; 1 at depth edges."""
    points = camera.back_project(depth).astype(float)
    # Central differences across an edge span two surfaces; the smaller one-sided step stays on one.
    normal = np.cross(_smaller_step(points, 1), _smaller_step(points, 0))
    length = np.linalg.norm(normal, axis=-1) * np.linalg.norm(camera.rays, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = np.abs((normal * camera.rays).sum(axis=-1)) / length
    return np.nan_to_num(cosine, nan=1.0)


def noisy_labels(
    labels: np.ndarray, rng: np.random.Generator, config: LabelNoiseConfig | None = None
) -> np.ndarray:
    """Labels (H, W) with masks eroded or dilated at random, and some leaking over their border.

    Nobody's mask is erased altogether: an object too small to be eroded keeps its mask.
    """
    config = config or LabelNoiseConfig()
    noisy = labels.copy()
    for label in rng.permutation(np.unique(labels[labels > 0])):
        mask = labels == label
        amount = int(rng.integers(-config.border_px, config.border_px + 1))
        if amount < 0:
            kept = ndimage.binary_erosion(mask, iterations=-amount)
            if kept.any():
                noisy[mask & ~kept] = 0
        elif amount > 0:
            noisy[ndimage.binary_dilation(mask, iterations=amount)] = label
        if rng.random() < config.leak:
            border = np.argwhere(mask & ~ndimage.binary_erosion(mask))
            row, column = border[rng.integers(len(border))]
            radius = int(rng.integers(config.leak_px[0], config.leak_px[1] + 1))
            rows, columns = np.ogrid[: labels.shape[0], : labels.shape[1]]
            noisy[(rows - row) ** 2 + (columns - column) ** 2 <= radius**2] = label
    for label in np.setdiff1d(np.unique(labels), np.unique(noisy)):
        noisy[labels == label] = label  # buried by its neighbours
    return noisy


def _edges(depth: np.ndarray, jump: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edge pixels (H, W) bool with the nearest and farthest depth [m] around each."""
    filled = np.nan_to_num(depth, nan=np.nanmax(depth))
    near = ndimage.minimum_filter(filled, size=3)
    far = ndimage.maximum_filter(filled, size=3)
    # A slanted plane has no edge: its pixel lies in the middle of its neighbours.
    bend = np.abs(near + far - 2 * filled)
    return (far - near > jump) & (bend > 0.5 * jump), near, far


def _rounded(depth: np.ndarray, config: SensorNoiseConfig) -> np.ndarray:
    import cv2

    if not np.isfinite(depth).any():
        return depth
    # What is missing must lie beyond a jump, and not so far that OpenCV's table of weights grows coarse.
    filled = np.nan_to_num(depth, nan=np.nanmax(depth) + 10 * config.edge_jump_m).astype(np.float32)
    smooth = cv2.bilateralFilter(filled, -1, 0.5 * config.edge_jump_m, config.rounding_px)
    return np.where(np.isfinite(depth), smooth, np.nan)


def _smooth_noise(shape: tuple[int, ...], patch: int, rng: np.random.Generator) -> np.ndarray:
    """Noise (H, W) of about unit variance that changes over `patch` pixels."""
    import cv2

    coarse = rng.standard_normal((shape[0] // patch + 2, shape[1] // patch + 2))
    return cv2.resize(coarse, (shape[1], shape[0]), interpolation=cv2.INTER_CUBIC)


def _smaller_step(points: np.ndarray, axis: int) -> np.ndarray:
    forward = np.diff(points, axis=axis, append=np.take(points, [-1], axis))
    backward = np.diff(points, axis=axis, prepend=np.take(points, [0], axis))
    first, last = [slice(None)] * 2, [slice(None)] * 2
    first[axis], last[axis] = slice(0, 1), slice(-1, None)
    backward[tuple(first)] = forward[tuple(first)]
    forward[tuple(last)] = backward[tuple(last)]
    smaller = np.linalg.norm(forward, axis=-1) < np.linalg.norm(backward, axis=-1)
    return np.where(smaller[..., None], forward, backward)
