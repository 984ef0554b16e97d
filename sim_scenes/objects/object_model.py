"""One rigid object of a scene: a metric mesh with its colours. Knows nothing of physics or cameras."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from mapping.errors import DataError

GREY = np.array([170, 170, 170], np.uint8)
"""Colour of meshes without one."""
SMOOTH_ANGLE_COSINE = 0.8
"""Corners where the surface turns more than this keep their edge when shaded."""
MOST_CORNERS = 24
"""Triangles that meet in a vertex beyond this number are left out when its normal is smoothed."""


@dataclass(frozen=True)
class ObjectModel:
    """A mesh [m] in its own frame with what is needed to draw it.

    name: unique in its source. source: "ycb" or "builtin". mesh: merged geometry, watertight if possible.
    corner_uv: (F, 3, 2) texture coordinates per triangle corner with texture (H, W, 3) uint8, or None;
    vertex_colors: (V, 3) uint8, used when there is no texture. path: the file it came from, or None.
    parts: points (N, 3) [m] of convex parts that make up the object, if known; else physics finds them.
    """

    name: str
    source: str
    mesh: trimesh.Trimesh
    vertex_colors: np.ndarray | None = None
    corner_uv: np.ndarray | None = field(default=None, repr=False)
    texture: np.ndarray | None = field(default=None, repr=False)
    path: Path | None = None
    parts: tuple[np.ndarray, ...] = field(default=(), repr=False)

    @cached_property
    def watertight(self) -> bool:
        """Whether inside and outside of the mesh are well defined."""
        return is_closed(self.mesh)

    @cached_property
    def connected(self) -> bool:
        """Whether the mesh is one piece; scans of transparent objects may fall apart."""
        return bool(self.mesh.body_count == 1)

    @cached_property
    def corner_normals(self) -> np.ndarray:
        """Unit normals (F, 3, 3) per triangle corner, for shading: smooth, but sharp along edges."""
        return corner_normals(self.mesh)

    @cached_property
    def center_of_mass(self) -> np.ndarray:
        """(3,) [m] in the object's frame; of the convex hull when the mesh is open."""
        solid = self.mesh if self.watertight and self.mesh.volume > 0 else self.mesh.convex_hull
        return np.asarray(solid.center_mass, float)

    def save(self, path: Path) -> None:
        """Write geometry and vertex colours as binary PLY [m]; a texture is not kept."""
        colors = self.vertex_colors
        if colors is None:
            colors = np.broadcast_to(GREY, (len(self.mesh.vertices), 3))
        colored = trimesh.Trimesh(self.mesh.vertices, self.mesh.faces, vertex_colors=colors, process=False)
        colored.export(path, file_type="ply")


def is_closed(mesh: trimesh.Trimesh) -> bool:
    """Whether every edge is crossed as often one way as the other, so that the surface bounds a volume.

    Wider than trimesh's `is_watertight`, which refuses edges where four triangles meet; scans touch
    themselves in such edges and still have a well-defined inside.
    """
    edges = np.asarray(mesh.edges, np.int64)
    low, high = edges.min(axis=1), edges.max(axis=1)
    direction = np.where(edges[:, 0] == low, 1, -1)
    _, inverse = np.unique(low * (len(mesh.vertices) + 1) + high, return_inverse=True)
    return bool((np.bincount(inverse, weights=direction) == 0).all())


def corner_normals(mesh: trimesh.Trimesh) -> np.ndarray:
    """Unit normals (F, 3, 3) per triangle corner: smooth, but sharp where the surface has an edge."""
    faces, flat = np.asarray(mesh.faces), np.asarray(mesh.face_normals)
    areas = np.asarray(mesh.area_faces)
    # Corners that share a vertex lie next to each other once sorted by vertex; pair each with the next ones.
    order = np.argsort(faces.ravel(), kind="stable")
    vertex, face = faces.ravel()[order], order // 3
    total = areas[face, None] * flat[face]
    for step in range(1, MOST_CORNERS):
        same = vertex[step:] == vertex[:-step]
        if not same.any():
            break
        first, second = np.flatnonzero(same), np.flatnonzero(same) + step
        alike = np.einsum("nd,nd->n", flat[face[first]], flat[face[second]]) > SMOOTH_ANGLE_COSINE
        first, second = first[alike], second[alike]
        np.add.at(total, first, areas[face[second], None] * flat[face[second]])
        np.add.at(total, second, areas[face[first], None] * flat[face[first]])
    normals = np.empty_like(total)
    normals[order] = total
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
    return normals.reshape(-1, 3, 3).astype(np.float32)


def load_model(path: Path, name: str, source: str, scale: float = 1.0) -> ObjectModel:
    """Read a mesh file (OBJ, PLY, STL ...) with its texture or colours; scale turns file units into metres.

    Raises DataError when the file is missing or holds no triangles.
    """
    if not path.is_file():
        raise DataError(f"{path}: no such mesh file")
    try:
        raw = trimesh.load(path, force="mesh", process=False)
    except Exception as error:  # trimesh raises many types for broken files
        raise DataError(f"{path}: cannot be read as a mesh ({error})") from error
    if not isinstance(raw, trimesh.Trimesh) or len(raw.faces) == 0:
        raise DataError(f"{path}: holds no triangles")
    vertices = np.asarray(raw.vertices, float) * scale
    # Texture seams split vertices; the geometry needs them merged to be watertight.
    unique, first, merged = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    merged = merged.reshape(-1)
    faces = merged[raw.faces]
    proper = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    mesh = trimesh.Trimesh(unique, faces[proper], process=False)
    corner_uv, texture = _texture(raw, proper)
    vertex_colors = None
    visual: Any = raw.visual
    if texture is None and visual.kind in ("vertex", "face"):
        vertex_colors = np.asarray(visual.vertex_colors)[first, :3].astype(np.uint8)
    elif texture is None:
        color = getattr(getattr(visual, "material", None), "main_color", None)
        plain = GREY if color is None else np.asarray(color[:3], np.uint8)
        vertex_colors = np.tile(plain, (len(unique), 1))
    return ObjectModel(name, source, mesh, vertex_colors, corner_uv, texture, path)


def _texture(raw: trimesh.Trimesh, proper: np.ndarray) -> tuple[np.ndarray | None, np.ndarray | None]:
    visual: Any = raw.visual
    if visual.kind != "texture" or visual.uv is None:
        return None, None
    image = getattr(visual.material, "image", None)
    if image is None:
        image = getattr(visual.material, "baseColorTexture", None)
    if image is None:
        return None, None
    corner_uv = np.asarray(visual.uv, np.float32)[np.asarray(raw.faces)[proper]]
    return corner_uv, np.asarray(image.convert("RGB"))
