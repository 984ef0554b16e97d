"""Light on surfaces: a soft area light, sky light darkened near contacts, and a little gloss."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

LIGHT_POSITION = np.array([0.7, -0.9, 1.8], np.float32)
"""Centre of the lamp [m]."""
LIGHT_RADIUS = 0.35
"""Radius [m] of the lamp: the larger, the softer the shadows."""
SKY_REACH = 0.12
"""Surfaces within this distance [m] keep sky light from each other."""
SAMPLES = 4
"""Shadow rays and sky rays per shaded pixel."""


@dataclass(frozen=True)
class Surface:
    """What each ray hit, arrays (H, W, ...): hit bool, positions [m], unit normals, albedo 0..1, directions."""

    hit: np.ndarray
    positions: np.ndarray
    normals: np.ndarray
    albedo: np.ndarray
    directions: np.ndarray


def shade(scene: Any, surface: Surface, rng: np.random.Generator, coarse: int) -> np.ndarray:
    """Colour image (H, W, 3) in 0..1; shadows are cast at every `coarse`-th pixel and smoothed."""
    import cv2

    sample = (slice(coarse // 2, None, coarse), slice(coarse // 2, None, coarse))
    positions, normals = surface.positions[sample], surface.normals[sample]
    lit = _visible(scene, positions, normals, _lamp_points(positions.shape[:2], rng) - positions[None])
    open_sky = _visible(scene, positions, normals, SKY_REACH * _hemisphere(normals, rng))
    fine = (surface.hit.shape[1], surface.hit.shape[0])
    # Few rays a pixel are noisy: smooth them, but not across edges in depth or orientation.
    guide = np.concatenate([normals, positions * 8], axis=-1)
    lit, open_sky = _smooth(lit, guide), _smooth(open_sky, guide)
    lit = cv2.resize(lit, fine, interpolation=cv2.INTER_LINEAR)
    open_sky = cv2.resize(open_sky, fine, interpolation=cv2.INTER_LINEAR)

    to_lamp = LIGHT_POSITION - surface.positions
    distance = np.linalg.norm(to_lamp, axis=-1, keepdims=True)
    to_lamp = to_lamp / distance
    cosine = np.clip((surface.normals * to_lamp).sum(axis=-1), 0, None)
    falloff = np.clip((2.1 / distance[..., 0]) ** 2, 0, 1.5)
    sky = (0.5 + 0.5 * surface.normals[..., 2]) * 0.35 + 0.22
    half = to_lamp - surface.directions / np.linalg.norm(surface.directions, axis=-1, keepdims=True)
    half /= np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), 1e-6)
    gloss = 0.10 * np.clip((surface.normals * half).sum(axis=-1), 0, 1) ** 40 * lit
    light = 0.72 * cosine * falloff * lit + sky * (0.35 + 0.65 * open_sky)
    # Albedo and output are display colours; light adds up in linear ones.
    linear = np.power(surface.albedo, 2.2) * light[..., None] + gloss[..., None]
    image = np.power(np.clip(linear, 0, 1), 1 / 2.2)
    image[~surface.hit] = 0.85
    return image


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
    blocked = scene.test_occlusions(open3d.core.Tensor(np.ascontiguousarray(rays)), tfar=0.98).numpy()
    return 1 - blocked.mean(axis=0, dtype=np.float32)


def _smooth(image: np.ndarray, guide: np.ndarray, radius: int = 5, tolerance: float = 0.25) -> np.ndarray:
    """Mean over neighbours whose guide values (H, W, D) are alike."""
    from itertools import product

    total = np.zeros_like(image)
    weight = np.zeros_like(image)
    for dy, dx in product(range(-radius, radius + 1, 2), repeat=2):
        shifted = np.roll(guide, (dy, dx), axis=(0, 1))
        near = np.exp(-((shifted - guide) ** 2).sum(axis=-1) / tolerance**2)
        total += near * np.roll(image, (dy, dx), axis=(0, 1))
        weight += near
    return (total / weight).astype(np.float32)
