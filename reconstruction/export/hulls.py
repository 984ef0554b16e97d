"""Convex hulls as engines take them: closed, wound outwards, not flat. Knows points only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh

from perception.camera import transform
from reconstruction.export.cutting import Surface, hull_surface


@dataclass(frozen=True, eq=False)
class Hull:
    """A convex part: vertices (V, 3) [m] and faces (F, 3) of its closed surface.

    There are hundreds of them an object, of a few faces each: plain arrays take a tenth of a Trimesh's time.
    """

    vertices: np.ndarray
    faces: np.ndarray

    @staticmethod
    def of(mesh: trimesh.Trimesh) -> Hull:
        """A convex mesh as a part."""
        return Hull(np.asarray(mesh.vertices, float), np.asarray(mesh.faces))

    @property
    def mesh(self) -> trimesh.Trimesh:
        """The same as a mesh."""
        return trimesh.Trimesh(self.vertices, self.faces, process=False)

    @cached_property
    def bounds(self) -> np.ndarray:
        """(2, 3) [m]: low and high corner."""
        return np.array([self.vertices.min(0), self.vertices.max(0)])

    @cached_property
    def face_normals(self) -> np.ndarray:
        """(F, 3), outwards; zero where a face has no area."""
        a, b, c = self.vertices[self.faces].transpose(1, 0, 2)
        across = _cross(b - a, c - a)
        length = np.sqrt(np.einsum("ij,ij->i", across, across))[:, None]
        return np.where(length > 1e-12, across / np.maximum(length, 1e-12), 0.0)

    @cached_property
    def heights(self) -> np.ndarray:
        """(F,) [m]: what is inside has normal x <= height for all faces."""
        return np.einsum("ij,ij->i", self.face_normals, self.vertices[self.faces[:, 0]])

    @cached_property
    def edges_unique(self) -> np.ndarray:
        """(E, 2): the edges, each once."""
        edges = self.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        return edges[edges[:, 0] < edges[:, 1]]  # a closed surface has each in either direction

    @cached_property
    def volume(self) -> float:
        """[m^3]"""
        a, b, c = (self.vertices - self.vertices[0])[self.faces].transpose(1, 0, 2)
        return float(np.einsum("ij,ij->", a, _cross(b, c)) / 6)

    def moved(self, T: np.ndarray) -> Hull:
        """Under the rigid T (4, 4)."""
        return Hull(transform(T, self.vertices), self.faces)


def convex_hull(points: np.ndarray) -> Hull | None:
    """The closed convex hull of points (N, 3) [m]; None when it is flat, which no engine accepts."""
    import manifold3d

    found = hull_surface(manifold3d.Manifold.hull_points(points))
    return None if found is None else Hull(*found)


def surfaces(parts: Sequence[Hull]) -> list[Surface]:
    """Vertices and faces of each part."""
    return [(part.vertices, part.faces) for part in parts]


def together(parts: Sequence[Hull]) -> trimesh.Trimesh:
    """All surfaces as one mesh."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = np.concatenate([part.faces + start for part, start in zip(parts, starts)])
    return trimesh.Trimesh(np.concatenate([part.vertices for part in parts]), faces, process=False)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Of rows (N, 3): numpy's own takes five times as long on few."""
    x, y, z = a.T
    u, v, w = b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)
