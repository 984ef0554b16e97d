"""Pairs of places on an object where two fingers can meet: antipodal contacts. Knows surfaces only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import KDTree

from reconstruction.solid import Solid
from tools.grasping.shapes import Cloud

SMOOTHED = 0.006
"""Normals are averaged over this distance [m]: a finger's pad is no smaller."""
TILT = np.deg2rad(12)
"""Largest angle between a finger's way and the surface's normal that is tried first."""
LEAST_WIDTH = 0.003
"""Between contacts [m]."""


@dataclass(frozen=True)
class Contacts:
    """first, second: (N, 3) [m]; normals outwards (N, 3); slips: (N,) the larger angle [rad] between the line
    of the two and a normal."""

    first: np.ndarray
    second: np.ndarray
    slips: np.ndarray

    @property
    def widths(self) -> np.ndarray:
        """(N,) [m]"""
        return np.linalg.norm(self.second - self.first, axis=1)

    @property
    def directions(self) -> np.ndarray:
        """(N, 3) unit vectors from the first to the second."""
        return (self.second - self.first) / self.widths[:, None]


def through(mesh: trimesh.Trimesh, count: int, widest: float, rng: np.random.Generator) -> Contacts:
    """Contacts of a closed mesh: from drawn points through its body, to where the ray comes out first (a
    wall), and to its far side."""
    cloud = sampled(mesh, 4 * count, rng)
    chosen = rng.permutation(len(cloud.points))[:count]
    points, normals = cloud.points[chosen], cloud.normals[chosen]
    ways = _tilted(-normals, rng)
    solid = Solid(mesh)
    inner = 2e-4
    near = inner + solid.cast(points + inner * ways, ways)
    far = widest - solid.cast(points + widest * ways, -ways)
    first = np.concatenate([points, points])
    along = np.concatenate([near, far])
    ways = np.concatenate([ways, ways])
    with np.errstate(invalid="ignore"):
        good = np.isfinite(along) & (along > LEAST_WIDTH) & (along < widest)
    # The same end twice is one pair.
    good[len(near) :] &= ~(np.abs(far - near) < 1e-4)
    first, ways, along = first[good], ways[good], along[good]
    second = first + ways * along[:, None]
    normals = np.concatenate([normals, normals])[good]
    return Contacts(first, second, _slips(ways, normals, _normals_at(second, ways, cloud)))


def across(cloud: Cloud, count: int, widest: float, rng: np.random.Generator) -> Contacts:
    """Contacts among measured points, all on sides that the camera saw: the line of a pair leaves both."""
    points = cloud.points
    a, b = rng.integers(len(points), size=(2, 20 * count))
    ways = points[b] - points[a]
    widths = np.linalg.norm(ways, axis=1)
    good = (widths > LEAST_WIDTH) & (widths < widest)
    a, b, ways = a[good], b[good], ways[good] / widths[good, None]
    slips = _slips(ways, cloud.normals[a], cloud.normals[b])
    best = np.argsort(slips, kind="stable")[:count]
    return Contacts(points[a[best]], points[b[best]], slips[best])


def sampled(mesh: trimesh.Trimesh, count: int, rng: np.random.Generator) -> Cloud:
    """Points drawn evenly from a mesh, with normals smoothed over the size of a finger's pad."""
    triangles = np.asarray(mesh.triangles)
    edges = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    areas = np.linalg.norm(edges, axis=1)
    face = np.searchsorted(np.cumsum(areas) / areas.sum(), rng.random(count)).clip(max=len(areas) - 1)
    u, v = rng.random((2, count))
    outside = u + v > 1
    u[outside], v[outside] = 1 - u[outside], 1 - v[outside]
    corner = triangles[face]
    points = corner[:, 0] + u[:, None] * (corner[:, 1] - corner[:, 0]) + v[:, None] * (
        corner[:, 2] - corner[:, 0]
    )  # fmt: skip
    flat = edges[face] / np.maximum(areas[face], 1e-20)[:, None]
    pairs = KDTree(points).query_pairs(SMOOTHED, output_type="ndarray")
    alike = pairs[np.einsum("ij,ij->i", flat[pairs[:, 0]], flat[pairs[:, 1]]) > 0.3]
    total = flat.copy()
    np.add.at(total, alike[:, 0], flat[alike[:, 1]])
    np.add.at(total, alike[:, 1], flat[alike[:, 0]])
    return Cloud(points, total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12))


def _tilted(ways: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Unit vectors (N, 3) turned by up to TILT."""
    shift = rng.normal(size=ways.shape) * np.tan(TILT) / 2
    turned = ways + shift
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)


def _normals_at(points: np.ndarray, ways: np.ndarray, cloud: Cloud) -> np.ndarray:
    """The cloud's normal nearest to each point, of those that face along its way."""
    if not len(points):
        return np.zeros((0, 3))
    _, near = KDTree(cloud.points).query(points, k=8)
    facing = np.einsum("nkd,nd->nk", cloud.normals[near], ways) > 0
    first = np.where(facing.any(1), facing.argmax(1), 0)
    return cloud.normals[near[np.arange(len(points)), first]]


def _slips(ways: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(N,) larger angle [rad] between ways (N, 3) and the inward normal of the start, outward of the end."""
    cosines = np.minimum(-(ways * first).sum(1), (ways * second).sum(1))
    return np.arccos(np.clip(cosines, -1, 1))
