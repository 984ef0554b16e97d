"""Light on surfaces: a soft area light, sky light darkened near contacts, and a little gloss."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

LIGHT_POSITION = np.array([0.7, -0.9, 1.8], np.float32)
"""Centre of the lamp [m]."""
LIGHT_RADIUS = 0.35
"""Radius [m] of the lamp: the larger, the softer the shadows."""
LIGHT_REACH = 2.1
"""Distance [m] at which the lamp shines with its nominal strength."""
SKY_REACH = 0.12
"""Surfaces within this distance [m] keep sky light from each other."""
SAMPLES = 4
"""Shadow rays and sky rays per shaded pixel."""


@dataclass(frozen=True)
class Surface:
    """What rays hit, arrays (..., D): hit bool, positions [m], unit normals, albedo 0..1, ray directions."""

    hit: np.ndarray
    positions: np.ndarray
    normals: np.ndarray
    albedo: np.ndarray
    directions: np.ndarray


def cast_shadows(scene: Any, surface: Surface, rng: np.random.Generator) -> np.ndarray:
    """(H, W, 2) shares of the lamp and of the sky that the surface of an image (H, W) sees."""
    positions, normals = surface.positions, surface.normals
    lit = _visible(scene, positions, normals, _lamp_points(positions.shape[:2], rng) - positions[None])
    open_sky = _visible(scene, positions, normals, SKY_REACH * _hemisphere(normals, rng))
    # Few rays a pixel are noisy: smooth them, but not across edges in depth or orientation.
    guide = np.concatenate([normals, positions * 8], axis=-1)
    return _smooth(np.stack([lit, open_sky], axis=-1), guide)


def shade(surface: Surface, shadows: np.ndarray) -> np.ndarray:
    """Display colours (..., 3) in 0..1 of a surface with its shares of lamp and sky (..., 2)."""
    lit, open_sky = shadows[..., 0], shadows[..., 1]
    to_lamp = LIGHT_POSITION - surface.positions
    distance = np.sqrt(_dot(to_lamp, to_lamp))
    to_lamp /= distance[..., None]
    falloff = np.minimum((LIGHT_REACH / distance) ** 2, 1.5)
    sky = 0.395 + 0.175 * surface.normals[..., 2]
    light = 0.72 * np.maximum(_dot(surface.normals, to_lamp), 0) * falloff * lit
    light += sky * (0.35 + 0.65 * open_sky)
    half = to_lamp - surface.directions / np.sqrt(_dot(surface.directions, surface.directions))[..., None]
    shine = np.clip(_dot(surface.normals, half) / np.maximum(np.sqrt(_dot(half, half)), 1e-6), 0, 1)
    for _ in range(5):
        shine = shine * shine  # to the power of 32
    # Albedo and output are display colours (taken as squares); light adds up in linear ones.
    linear = surface.albedo * surface.albedo * light[..., None] + (0.10 * shine * lit)[..., None]
    image = np.sqrt(np.clip(linear, 0, 1))
    image[~surface.hit] = 0.85
    return image


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("...c,...c->...", a, b)


def _lamp_points(shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """(SAMPLES, H, W, 3) points on the lamp's disc, stratified by angle."""
    angle = (rng.random((SAMPLES, *shape)) + np.arange(SAMPLES)[:, None, None]) * (2 * np.pi / SAMPLES)
    radius = LIGHT_RADIUS * np.sqrt(rng.random((SAMPLES, *shape)))
    disc = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros_like(angle)], axis=-1)
    return (LIGHT_POSITION + disc).astype(np.float32)


def _hemisphere(normals: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(SAMPLES, H, W, 3) directions above the surface, denser towards its normal."""
    ball = rng.standard_normal((SAMPLES, *normals.shape), dtype=np.float32)
    ball /= np.linalg.norm(ball, axis=-1, keepdims=True)
    return ball + 1.01 * normals[None]


def _visible(scene: Any, positions: np.ndarray, normals: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """(H, W) share of the segments `towards` (S, H, W, 3) [m] that are free."""
    import open3d

    origins = np.broadcast_to(positions + 5e-4 * normals, towards.shape)
    rays = np.concatenate([origins, towards], axis=-1).astype(np.float32)
    blocked = scene.test_occlusions(
        open3d.core.Tensor.from_numpy(np.ascontiguousarray(rays)), tfar=0.98
    ).numpy()
    return 1 - blocked.mean(axis=0, dtype=np.float32)


def _smooth(image: np.ndarray, guide: np.ndarray, taps: int = 4, tolerance: float = 0.25) -> np.ndarray:
    """Mean of image (H, W, C) over neighbours whose guide values (H, W, D) are alike, along one axis, then
    along the other."""
    for axis in (0, 1):
        total, weight = image.copy(), np.ones(image.shape[:2], np.float32)
        for shift in range(-taps, taps + 1):
            if shift == 0:
                continue
            step = np.roll(guide, shift, axis) - guide
            near = 1 / (1 + (_dot(step, step) / tolerance**2) ** 2)
            total += near[..., None] * np.roll(image, shift, axis)
            weight += near
        image = total / weight[..., None]
    return image
