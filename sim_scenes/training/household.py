"""Household meshes from a folder as training shapes, beside the procedural ones, in all sizes.

Knows meshes and their size; knows nothing of scenes and of the prior. No mesh is kept in this project.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import trimesh

from sim_scenes.objects.mesh_folder import FolderConfig, MeshFolder, mesh_files
from sim_scenes.objects.split import held_out
from sim_scenes.training.shapes import TRAINING_FAMILIES, TrainingShape, draw_shape

SCALE, STRETCH = 0.3, 0.08
"""Sizes of meshes vary by up to this in the logarithm; each axis by up to this on top."""
HOLLOW_FILL = 0.55
"""Meshes that fill less of their convex hull are hollow or branched."""
SOLID_RATE = 0.35
"""How often a mesh is drawn that is neither, beside one that is."""
LARGE, LARGE_M = 0.14, (0.25, 0.6)
"""Share of shapes made large, and their longest side [m]."""
SMALL, SMALL_M = 0.08, (0.015, 0.06)
"""Share of shapes made small, and their longest side [m]."""
HOLLOW_MESH = "hollow mesh"
"""What such meshes are called as a family."""
SAME_SIDE, SAME_VOLUME = 0.01, 0.03
"""Meshes of two sources that differ by less than this in sides and volume may be one object."""
REFUSED_LICENCES = ("mixed", "NC", "ND")
"""Words in a licence that keep an object from being learned from."""
SOURCES_FILE = "SOURCES.json"


@dataclass(frozen=True)
class Household:
    """Draws shapes: a share of them meshes of a folder, the others procedural. Same rng, same shape."""

    folder: Path
    names: tuple[str, ...]
    share: float = 0.6

    def __call__(self, rng: np.random.Generator) -> TrainingShape:
        if rng.random() < self.share:
            return resized(self._mesh(rng), rng)
        return resized(draw_shape(rng, TRAINING_FAMILIES), rng)

    def _mesh(self, rng: np.random.Generator) -> TrainingShape:
        while True:
            name = self.names[rng.integers(len(self.names))]
            found = _load(self.folder, name)
            if found is None:
                continue
            mesh, fill = found
            if fill < HOLLOW_FILL or rng.random() < SOLID_RATE:
                break
        mesh = mesh.copy()
        mesh.vertices = mesh.vertices * np.exp(rng.uniform(-SCALE, SCALE) + rng.uniform(-STRETCH, STRETCH, 3))
        return TrainingShape(HOLLOW_MESH if fill < HOLLOW_FILL else "solid mesh", (mesh,))


@dataclass(frozen=True)
class Meshes:
    """Draws the meshes of a folder as they are, named by kind: to judge on."""

    folder: Path
    kinds: tuple[tuple[str, str], ...]

    def __call__(self, rng: np.random.Generator) -> TrainingShape:
        while True:
            name, kind = self.kinds[rng.integers(len(self.kinds))]
            found = _load(self.folder, name)
            if found is not None:
                break
        large = float(found[0].extents.max()) > LARGE_M[0]
        return TrainingShape(f"{kind}, large" if large else kind, (found[0].copy(),))


def resized(shape: TrainingShape, rng: np.random.Generator) -> TrainingShape:
    """The shape, now and then made large or small as a whole."""
    draw = rng.random()
    if draw < LARGE:
        longest = rng.uniform(*LARGE_M)
    elif draw < LARGE + SMALL:
        longest = float(np.exp(rng.uniform(*np.log(SMALL_M))))
    else:
        return shape
    corners = np.concatenate([part.vertices for part in shape.parts])
    scale = longest / np.ptp(corners, axis=0).max()
    for part in shape.parts:
        part.vertices = part.vertices * scale
    return shape


def training_names(folder: Path) -> tuple[str, ...]:
    """Objects of a folder that may be learned from: the part `train`, without what its SOURCES.json (if there
    is one) gives an unfit licence, or measures as a held-out object has."""
    names = [name for name in mesh_files(folder) if not held_out(name)]
    listed = sources(folder)
    judged = [item for name, item in listed.items() if held_out(name)]
    return tuple(
        name
        for name in names
        if name not in listed
        or not (
            any(word in listed[name]["licence"] for word in REFUSED_LICENCES)
            or any(_same(listed[name], other) for other in judged)
        )
    )


def held_out_kinds(folder: Path) -> tuple[tuple[str, str], ...]:
    """Name and kind (from SOURCES.json, else "mesh") of a folder's objects that are never learned from."""
    listed = sources(folder)
    return tuple((n, listed.get(n, {}).get("kind", "mesh")) for n in mesh_files(folder) if held_out(n))


def sources(folder: Path) -> dict[str, dict]:
    """Name -> licence, kind and measures as the folder's SOURCES.json lists them; empty without one."""
    path = folder / SOURCES_FILE
    if not path.is_file():
        return {}
    by_file = {folder / item["file"]: item for item in json.loads(path.read_text())["objects"]}
    return {name: by_file[file] for name, file in mesh_files(folder).items() if file in by_file}


def _same(one: dict, other: dict) -> bool:
    sides = np.sort(one["extents_m"]), np.sort(other["extents_m"])
    volumes = one["volume_l"], other["volume_l"]
    return bool(np.allclose(*sides, rtol=SAME_SIDE) and np.isclose(*volumes, rtol=SAME_VOLUME))


@lru_cache(maxsize=4)
def _open(folder: Path) -> MeshFolder:
    return MeshFolder.open(folder, FolderConfig())


@lru_cache(maxsize=1024)
def _load(folder: Path, name: str) -> tuple[trimesh.Trimesh, float] | None:
    """A mesh and the share of its convex hull that it fills; None when it is not closed."""
    model = _open(folder).load(name)
    if model is None:
        return None
    return model.mesh, float(model.mesh.volume / model.mesh.convex_hull.volume)
