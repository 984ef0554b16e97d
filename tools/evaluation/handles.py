"""Handles of meshes: as many as the genus says, and, of true ones, as many as something fits through.

Scans have pinholes and folds: a scanned plate has genus 96. Knows meshes; nothing of scenes and methods.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import trimesh
from scipy import ndimage

from reconstruction.solid import Solid

PROBE = 0.0025
"""True handles are those through which a ball of this radius fits [m]."""
NODES = 72
"""The lattice on which they are counted has no more nodes along an axis; its spacing is PROBE or more."""


def handles_and_parts(mesh: trimesh.Trimesh) -> tuple[int | None, int]:
    """Genus of a closed mesh, summed over its parts (None when it is not closed), and the number of parts."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    count = len(mesh.vertices)
    used = np.zeros(count, bool)
    used[mesh.faces.ravel()] = True
    a, b = mesh.edges.T
    links = coo_matrix((np.ones(len(a), np.int8), (a, b)), (count, count))
    _, part = connected_components(links, directed=False)
    parts = len(np.unique(part[used]))
    if not mesh.is_watertight:
        return None, parts
    euler = int(used.sum()) - len(mesh.edges_unique) + len(mesh.faces)
    return parts - euler // 2, parts


@lru_cache(maxsize=64)
def true_handles(solid: Solid) -> int:
    """Handles of a solid through which a ball of radius PROBE fits: its genus when it is grown by so much."""
    from skimage.measure import marching_cubes

    low, high = solid.mesh.bounds
    spacing = max(PROBE, float((high - low).max()) / NODES)
    axes = [np.arange(a - 3 * spacing, b + 3 * spacing, spacing) for a, b in zip(low, high)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    within = PROBE - solid.distance(grid.astype(np.float32))
    # What the grown surface encloses is inside.
    enclosed = ndimage.binary_fill_holes(within > 0) & (within <= 0)
    within[enclosed] = PROBE
    vertices, faces, _, _ = marching_cubes(within, 0.0)
    handles, _ = handles_and_parts(trimesh.Trimesh(vertices, faces, process=False))
    return handles or 0
