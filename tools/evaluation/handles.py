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
COARSE = 4
"""Of so many nodes along each axis, the middle tells whether all are far from the surface."""


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

    within = _grown(solid)
    # What the grown surface encloses is inside.
    enclosed = ndimage.binary_fill_holes(within > 0) & (within <= 0)
    within[enclosed] = PROBE
    vertices, faces, _, _ = marching_cubes(within, 0.0)
    handles, _ = handles_and_parts(trimesh.Trimesh(vertices, faces, process=False))
    return handles or 0


def _grown(solid: Solid) -> np.ndarray:
    """How far nodes (nx, ny, nz), PROBE apart, are within a solid that is grown by PROBE [m]; far from its
    surface only the sign is right."""
    low, high = solid.mesh.bounds
    counts = np.ceil((high - low) / (PROBE * COARSE)).astype(int) + 2
    first = low - 3 * PROBE
    block = np.stack(np.meshgrid(*3 * [np.arange(COARSE)], indexing="ij"), -1).reshape(-1, 3) * PROBE
    corners = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), -1).reshape(-1, 3)
    corners = (first + corners * (COARSE * PROBE)).astype(np.float32)
    middle = PROBE - solid.distance((corners + block.mean(0)).astype(np.float32))
    within = np.repeat(middle[:, None], COARSE**3, 1)
    near = np.abs(middle) <= 1.01 * np.linalg.norm(block.mean(0))
    nodes = (corners[near, None] + block).astype(np.float32)
    within[near] = PROBE - solid.distance(nodes.reshape(-1, 3)).reshape(len(nodes), -1)
    split = within.reshape(*counts, COARSE, COARSE, COARSE).transpose(0, 3, 1, 4, 2, 5)
    return split.reshape(COARSE * counts)
