"""Watertight meshes of composed solids: distances [m] to simple bodies, joined and cut, then meshed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from sim_scenes.objects.decimation import decimated

Distance = Callable[[np.ndarray], np.ndarray]
"""Maps points (..., 3) [m] to distances (...) [m], negative inside."""

MOST_CELLS = 1_000_000
"""Cells of the lattice a shape is meshed on; large shapes get larger cells."""
TUBE_REACH = 0.02
"""Distances [m] to bars are exact below this; more than any fillet needs."""


def mesh_of(
    distance: Distance, low: Sequence[float], high: Sequence[float], cell: float = 0.0012, faces: int = 12_000
) -> trimesh.Trimesh:
    """The zero level set within the box low..high [m] on a lattice of `cell` [m], simplified to `faces`."""
    from skimage.measure import marching_cubes

    start, extent = np.array(low, float), np.array(high, float) - np.array(low, float)
    cell = max(cell, float(np.cbrt(extent.prod() / MOST_CELLS)))
    start, extent = start - 3 * cell, extent + 6 * cell  # the border is outside, so that the mesh closes
    axes = [begin + cell * np.arange(int(np.ceil(length / cell)) + 1) for begin, length in zip(start, extent)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).astype(np.float32)
    values = distance(points)
    # A lattice point on the surface itself would give triangles without area, and a mesh that does not close.
    values = np.where(values < 0, np.minimum(values, -0.02 * cell), np.maximum(values, 0.02 * cell))
    vertices, triangles, _, _ = marching_cubes(values, 0.0, spacing=(cell,) * 3)
    mesh = trimesh.Trimesh(vertices + start, triangles[:, ::-1], process=True)
    if mesh.volume < 0:
        mesh.invert()
    mesh = _largest(mesh)
    return _simplified(mesh, faces)


def _largest(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    bodies = mesh.split(only_watertight=False)
    return max(bodies, key=lambda body: len(body.faces)) if len(bodies) > 1 else mesh


def _simplified(mesh: trimesh.Trimesh, faces: int) -> trimesh.Trimesh:
    """Fewer triangles where that keeps the mesh closed, else the mesh as it was."""
    result = decimated(mesh, faces)
    return result if result.is_watertight and result.is_winding_consistent else mesh


def sphere(points: np.ndarray, center: Sequence[float], radius: float) -> np.ndarray:
    """Distance to a ball."""
    return np.linalg.norm(points - np.array(center, np.float32), axis=-1) - radius


def ellipsoid(points: np.ndarray, center: Sequence[float], radii: Sequence[float]) -> np.ndarray:
    """Approximate distance to an axis-aligned ellipsoid."""
    scaled = (points - np.array(center, np.float32)) / np.array(radii, np.float32)
    length = np.linalg.norm(scaled, axis=-1)
    gradient = np.linalg.norm(scaled / np.array(radii, np.float32), axis=-1)
    return (length - 1) * length / np.maximum(gradient, 1e-9)


def box(points: np.ndarray, center: ArrayLike, half: ArrayLike, rounding: float) -> np.ndarray:
    """Distance to an axis-aligned box with rounded edges; half: half extents [m] including the rounding."""
    inner = np.array(half, np.float32) - rounding
    beyond = np.abs(points - np.array(center, np.float32)) - inner
    outside = np.linalg.norm(np.maximum(beyond, 0), axis=-1)
    return outside + np.minimum(beyond.max(axis=-1), 0) - rounding


def cylinder(points: np.ndarray, radius: float, low: float, high: float) -> np.ndarray:
    """Distance to an upright cylinder about z between two heights."""
    radial = np.hypot(points[..., 0], points[..., 1]) - radius
    axial = np.abs(points[..., 2] - (low + high) / 2) - (high - low) / 2
    outside = np.hypot(np.maximum(radial, 0), np.maximum(axial, 0))
    return outside + np.minimum(np.maximum(radial, axial), 0)


def tube(points: np.ndarray, path: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Distance to a round bar along a polyline path (N, 3) with a radius at each node (N,).

    Exact near the bar; farther than TUBE_REACH from its bounding box it is TUBE_REACH, to save time.
    """
    reach = radii.max() + TUBE_REACH
    near = ((points > path.min(axis=0) - reach) & (points < path.max(axis=0) + reach)).all(axis=-1)
    chosen = points[near].astype(np.float32)
    best = np.full(len(chosen), TUBE_REACH, np.float32)
    for a, b, radius_a, radius_b in zip(path[:-1], path[1:], radii[:-1], radii[1:]):
        start, along = a.astype(np.float32), (b - a).astype(np.float32)
        offset = chosen - start
        share = np.clip(offset @ along / (along @ along), 0, 1)
        offset -= share[:, None] * along
        gap = np.sqrt(np.einsum("nc,nc->n", offset, offset))
        best = np.minimum(best, gap - np.float32(radius_a) - share * np.float32(radius_b - radius_a))
    distance = np.full(points.shape[:-1], TUBE_REACH, np.float32)
    distance[near] = best
    return distance


def smooth_union(a: np.ndarray, b: np.ndarray, blend: float) -> np.ndarray:
    """Union of two solids with a fillet of about `blend` [m]."""
    share = np.clip(0.5 + 0.5 * (b - a) / blend, 0, 1)
    return b + (a - b) * share - blend * share * (1 - share)


def revolved(
    profile: Sequence[tuple[float, float]], sections: int = 72, step: float = 0.003
) -> trimesh.Trimesh:
    """Closed solid of revolution about z; profile: (radius, z) [m] from axis to axis."""
    corners = np.array(profile, float)
    nodes = [corners[0]]
    for a, b in pairwise(corners):
        pieces = max(1, int(np.linalg.norm(b - a) / step))
        nodes += [a + (b - a) * (index + 1) / pieces for index in range(pieces)]
    line = np.array(nodes)
    line[[0, -1], 0] = 0.0
    mesh = trimesh.creation.revolve(line, sections=sections)
    mesh.merge_vertices()
    mesh.update_faces(mesh.nondegenerate_faces())
    if mesh.volume < 0:
        mesh.invert()
    return mesh
