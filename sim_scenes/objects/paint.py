"""Colours of built-in objects, given per vertex."""

from __future__ import annotations

import colorsys

import numpy as np
import trimesh

Shape = tuple[trimesh.Trimesh, np.ndarray, list[np.ndarray]]
"""A mesh, its (V, 3) colours in 0..1, and its convex parts as points (N, 3) [m]."""


def random_color(rng: np.random.Generator, strong: bool = True) -> np.ndarray:
    """A random paint colour, or with strong=False a pale or metallic one."""
    hue = rng.random()
    saturation, value = (
        (rng.uniform(0.45, 0.9), rng.uniform(0.45, 0.95))
        if strong
        else (rng.uniform(0, 0.12), rng.uniform(0.6, 0.92))
    )
    return np.array(colorsys.hsv_to_rgb(hue, saturation, value))


def plain(mesh: trimesh.Trimesh, color: np.ndarray) -> np.ndarray:
    """One colour (3,) for all vertices."""
    return np.tile(color, (len(mesh.vertices), 1))


def banded(mesh: trimesh.Trimesh, base: np.ndarray, *bands: tuple[float, float, np.ndarray]) -> np.ndarray:
    """Base colour with bands of colour between two heights [m] each."""
    colors = plain(mesh, base)
    z = mesh.vertices[:, 2]
    for low, high, color in bands:
        colors[(z >= low) & (z <= high)] = color
    return colors
