"""Watertight building blocks of procedural shapes: boxes, turned profiles, swept tubes, plates. Metres."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import ArrayLike

SECTIONS = 28
"""Corners of a round cross-section."""


def box(size: ArrayLike, centre: ArrayLike = (0.0, 0.0, 0.0)) -> trimesh.Trimesh:
    """An axis-aligned box of full lengths `size` around `centre`."""
    mesh = trimesh.creation.box(np.asarray(size, float))
    mesh.apply_translation(np.asarray(centre, float))
    return mesh


def turned(profile: ArrayLike, flatten: float = 1.0, power: float = 1.0) -> trimesh.Trimesh:
    """The solid swept by turning a profile of (radius, height) rows about z, from axis to axis.

    The profile runs upwards along the outside and, for hollow shapes, back down the inside.
    flatten: scale of y, for oval cross-sections; power: 1 for round ones, nearly square for small powers.
    """
    outline = np.asarray(profile, float)
    angle = np.linspace(0, 2 * np.pi, SECTIONS, endpoint=False)
    ring = np.stack([_bent(np.cos(angle), power), flatten * _bent(np.sin(angle), power)], axis=1)
    rings = np.concatenate(
        [
            outline[:, None, :1] * ring[None],
            np.broadcast_to(outline[:, None, 1:], (len(outline), SECTIONS, 1)),
        ],
        axis=2,
    )
    return _from_rings(rings)


def swept(path: np.ndarray, radii: np.ndarray) -> trimesh.Trimesh:
    """A closed tube along a path (P, 3) with oval cross-sections of half widths radii (P, 2).

    The first half width lies as level as it can, the second across it.
    """
    path, radii = np.asarray(path, float), np.asarray(radii, float)
    forward = np.gradient(path, axis=0)
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    # The direction least along the path on the whole stays clear of it.
    up = np.eye(3)[np.argmin((forward**2).sum(0) - np.array([0, 0, 1e-6]))]
    side = np.cross(up, forward)
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-9)
    across = np.cross(forward, side)
    angle = np.linspace(0, 2 * np.pi, SECTIONS // 2, endpoint=False)
    rings = (
        path[:, None]
        + radii[:, None, :1] * np.cos(angle)[None, :, None] * side[:, None]
        + radii[:, None, 1:] * np.sin(angle)[None, :, None] * across[:, None]
    )
    return _from_rings(rings)


def ring(centre: np.ndarray, radius: tuple[float, float], thickness: float) -> trimesh.Trimesh:
    """An oval ring in the xy plane: half lengths `radius` along x and y, wire of radius `thickness`."""
    angle = np.linspace(0, 2 * np.pi, SECTIONS, endpoint=False)
    outward = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    path = centre + outward * np.array([*radius, 1.0])
    turn = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    wire = (
        outward[:, None] * np.cos(turn)[None, :, None] + np.array([0, 0, 1.0]) * np.sin(turn)[None, :, None]
    )
    return _from_rings((path[:, None] + thickness * wire)[:, ::-1], closed=True)


def plate(outline: np.ndarray, thickness: float) -> trimesh.Trimesh:
    """A flat piece on z = 0 whose outline (P, 2) can be seen whole from its mean point."""
    rings = np.concatenate([np.stack([outline, outline])], axis=0)
    height = np.array([0.0, thickness])[:, None, None]
    return _from_rings(np.concatenate([rings, np.broadcast_to(height, (2, len(outline), 1))], axis=2))


def rounded(half: ArrayLike, power: float, centre: ArrayLike = (0.0, 0.0, 0.0)) -> trimesh.Trimesh:
    """A superellipsoid of half lengths `half`: an ellipsoid for power 1, nearly a box for small powers."""
    polar = np.linspace(-np.pi / 2, np.pi / 2, 17)[:, None]
    angle = np.linspace(0, 2 * np.pi, SECTIONS, endpoint=False)[None]

    ones = np.ones_like(angle)
    rings = np.stack(
        [
            _bent(np.cos(polar), power) * _bent(np.cos(angle), power),
            _bent(np.cos(polar), power) * _bent(np.sin(angle), power),
            _bent(np.sin(polar), power) * ones,
        ],
        axis=2,
    )
    return _from_rings(rings * np.asarray(half, float) + np.asarray(centre, float))


def _bent(value: np.ndarray, power: float) -> np.ndarray:
    """Sines of a circle bent towards those of a square."""
    return np.sign(value) * np.abs(value) ** power


def _from_rings(rings: np.ndarray, closed: bool = False) -> trimesh.Trimesh:
    """The closed surface through rings (R, S, 3) of corners; both ends are capped unless the rings close."""
    count, sections = rings.shape[:2]
    vertices = rings.reshape(-1, 3)
    index = np.arange(count * sections).reshape(count, sections)
    lower = index if closed else index[:-1]
    upper = np.roll(index, -1, axis=0) if closed else index[1:]
    a, b = lower, np.roll(lower, -1, axis=1)
    c, d = upper, np.roll(upper, -1, axis=1)
    faces = [np.stack([a, b, d], -1).reshape(-1, 3), np.stack([a, d, c], -1).reshape(-1, 3)]
    if not closed:
        ends = np.stack([rings[0].mean(0), rings[-1].mean(0)])
        bottom, top = len(vertices), len(vertices) + 1
        vertices = np.concatenate([vertices, ends])
        first, last = index[0], index[-1]
        faces.append(np.stack([np.roll(first, -1), first, np.full(sections, bottom)], -1))
        faces.append(np.stack([last, np.roll(last, -1), np.full(sections, top)], -1))
    return trimesh.Trimesh(vertices, np.concatenate(faces), process=False)
