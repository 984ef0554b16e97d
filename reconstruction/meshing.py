"""From log odds on a lattice to one closed surface with uncertainty. Knows lattices and meshes only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy import ndimage

from reconstruction.field import OUTSIDE, Field


@dataclass(frozen=True)
class MeshConfig:
    """How meshes are taken from the map."""

    spacing: float = 0.005
    """Lattice spacing [m]; also about the edge length of the triangles."""
    smallest_part: float = 0.05
    """Parts of an object smaller than this share of its largest part are dropped."""
    max_uncertainty: float | None = None
    """Keep only what is less uncertain than this (0..1); None keeps all."""


def extract_mesh(field: Field, index: int, config: MeshConfig) -> tuple[trimesh.Trimesh, np.ndarray] | None:
    """Closed mesh of object `index` in the field's frame and p(uncertain) at its vertices (V,).

    Returns None when the object occupies no node.
    """
    from skimage.measure import marching_cubes

    log_odds = field.log_odds[index]
    if config.max_uncertainty is not None:
        confident = np.where(field.uncertainty <= config.max_uncertainty, 1.0, -1.0).astype(np.float32)
        log_odds = np.minimum(log_odds, confident)
    inside = log_odds > 0
    if not inside.any():
        return None
    parts, count = ndimage.label(inside)
    if count > 1:
        sizes = np.bincount(parts.ravel())[1:]
        small = np.flatnonzero(sizes < config.smallest_part * sizes.max()) + 1
        log_odds = np.where(np.isin(parts, small), -0.01, log_odds)
        inside = log_odds > 0
    window = tuple(
        slice(max(int(w.start) - 1, 0), int(w.stop) + 1)
        for w in ndimage.find_objects(inside.astype(np.int8))[0]
    )
    values = log_odds[window]
    # A node exactly on the surface makes triangles without area.
    values = np.where(np.abs(values) < 1e-4, -1e-4, values)
    padded = np.pad(values, 1, constant_values=OUTSIDE)
    vertices, faces, _, _ = marching_cubes(padded, 0.0, gradient_direction="ascent", allow_degenerate=False)
    start = np.array([w.start for w in window])
    nodes = vertices - 1 + start
    limit = np.array(field.uncertainty.shape) - 1
    uncertainty = ndimage.map_coordinates(
        field.uncertainty, np.clip(nodes, 0, limit).T, order=1, mode="nearest"
    )
    mesh = trimesh.Trimesh(field.origin + field.spacing * nodes, faces[:, ::-1], process=False)
    if mesh.volume < 0:
        mesh.invert()
    return mesh, np.clip(uncertainty, 0, 1).astype(np.float32)
