"""Closed meshes as a few convex parts that physics engines accept, with their measured error; cached by
content.

Knows meshes only; nothing of results, formats or engines.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from queue import SimpleQueue

import numpy as np
import trimesh

from mapping.errors import DataError
from mapping.files import cache_dir, write_atomically
from mapping.guarded_files import read_npz
from reconstruction.export.coacd_process import CoacdProcess
from reconstruction.export.hulls import convex_hull
from reconstruction.export.parts_error import parts_error
from reconstruction.export.refine import refined
from reconstruction.export.tips import tips

VERSION = "3"
"""Changes when the same mesh would be cut differently by this code."""


@dataclass(frozen=True)
class CollisionConfig:
    """How finely a mesh is cut into convex parts."""

    concavity: float = 0.02
    """Largest concavity that the cutter leaves in a part [m]: what bulges is halved afterwards, which is
    faster."""
    bulge: float = 0.0022
    """A part that reaches further out of the mesh than this is halved, and what of the mesh is further than
    this from any part becomes one [m]."""
    simplify: float = 0.0012
    """The mesh is simplified by this much before it is cut [m]."""
    convex_within: float = 0.002
    """A mesh whose convex hull is nowhere further from it than this is one part [m]."""
    samples: int = 100
    """Points a part's concavity is measured with; the cutting takes time in proportion."""
    candidates: int = 5
    """Cutting planes tried along each axis."""
    iterations: int = 10
    """Rounds of the search for a cut."""
    seed: int = 0
    """Of the cutter."""
    merge: bool = False
    """Join parts again where their union is convex enough: a tenth fewer parts for three times the time."""
    time_limit_s: float = 120.0
    """Seconds after which an object becomes its convex hull; its error then says so."""


@dataclass(frozen=True)
class ConvexParts:
    """Convex hulls whose union stands for a mesh, in the mesh's frame.

    parts: closed meshes [m]. mesh: what they stand for. missing_m, excess_m: largest distance [m] from the
    mesh's surface to the parts, and of the parts' surface from within the mesh, over the sampled points of
    parts_error; worked out when first asked for.
    """

    parts: tuple[trimesh.Trimesh, ...]
    mesh: trimesh.Trimesh

    @cached_property
    def _errors(self) -> tuple[float, float]:
        return parts_error(self.mesh, self.parts)

    @property
    def missing_m(self) -> float:
        return self._errors[0]

    @property
    def excess_m(self) -> float:
        return self._errors[1]

    @property
    def error_m(self) -> float:
        return max(self._errors)


def convex_parts(
    meshes: Sequence[trimesh.Trimesh],
    config: CollisionConfig | None = None,
    done: Callable[[], None] = lambda: None,
) -> list[ConvexParts]:
    """Convex parts of each closed mesh [m]; `done` is called after each. Several are cut at a time."""
    config = config or CollisionConfig()
    workers = max(1, min(len(meshes), os.cpu_count() or 1))
    idle: SimpleQueue[CoacdProcess] = SimpleQueue()
    for _ in range(workers):
        idle.put(CoacdProcess())

    def one(mesh: trimesh.Trimesh) -> ConvexParts:
        process = idle.get()
        try:
            return _parts_of(mesh, config, process)
        finally:
            idle.put(process)
            done()

    try:
        # The largest first: the last one to finish decides.
        order = sorted(range(len(meshes)), key=lambda i: -len(meshes[i].faces))
        with ThreadPoolExecutor(workers) as pool:
            found = dict(zip(order, pool.map(lambda i: one(meshes[i]), order)))
    finally:
        for _ in range(workers):
            idle.get().close()
    return [found[i] for i in range(len(meshes))]


def _parts_of(mesh: trimesh.Trimesh, config: CollisionConfig, process: CoacdProcess) -> ConvexParts:
    path = _cached_path(mesh, config)
    points = _read(path)
    if points is None:
        points = _cut(mesh, config, process)
        if points:
            _write(path, points)
        else:  # failed this time, on a busy machine perhaps: not kept
            points = [np.asarray(mesh.convex_hull.vertices)]
    return ConvexParts(tuple(hull for part in points if (hull := convex_hull(part)) is not None), mesh)


def _cut(mesh: trimesh.Trimesh, config: CollisionConfig, process: CoacdProcess) -> list[np.ndarray]:
    """Vertices (N, 3) of each part; [] when it took too long or failed."""
    hull = mesh.convex_hull
    if max(parts_error(mesh, (hull,))) <= config.convex_within:
        return [np.asarray(hull.vertices)]
    settings = {
        "threshold": config.concavity,
        "real_metric": True,  # the threshold is in metres
        "preprocess_mode": "off",  # remeshing would grow thin parts by millimetres
        "resolution": config.samples,
        "mcts_nodes": config.candidates,
        "mcts_iterations": config.iterations,
        "mcts_max_depth": 1,
        "merge": config.merge,
        "seed": config.seed,
    }
    simple, manifold = simplified(mesh, config.simplify)
    if not manifold:
        settings["preprocess_mode"] = "on"
    hulls = refined(process.cut(simple, settings, config.time_limit_s), mesh, simple, config.bulge)
    lost = tips(mesh, hulls, config.bulge) if hulls else []
    return [np.asarray(part.vertices) for part in (*hulls, *lost)]


def simplified(mesh: trimesh.Trimesh, tolerance: float) -> tuple[trimesh.Trimesh, bool]:
    """The mesh with fewer triangles, nowhere moved by more than `tolerance` [m]; and whether it is manifold.

    A mesh that is not manifold comes back as it is.
    """
    import manifold3d

    given = manifold3d.Mesh(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32))
    solid = manifold3d.Manifold(given)
    if solid.status() != manifold3d.Error.NoError or solid.is_empty():
        return mesh, False
    simple = solid.simplify(tolerance).to_mesh()
    return trimesh.Trimesh(simple.vert_properties[:, :3].astype(float), simple.tri_verts, process=False), True


def _cached_path(mesh: trimesh.Trimesh, config: CollisionConfig) -> Path:
    digest = hashlib.sha256(repr((VERSION, sorted(asdict(config).items()))).encode())
    digest.update(np.ascontiguousarray(mesh.vertices, np.float32).tobytes())
    digest.update(np.ascontiguousarray(mesh.faces, np.int64).tobytes())
    return cache_dir() / "coacd_parts" / f"{digest.hexdigest()[:32]}.npz"


def _read(path: Path) -> list[np.ndarray] | None:
    """Parts kept from an earlier run; None when there are none, or the file is damaged."""
    if not path.is_file():
        return None
    try:
        parts = list(read_npz(path).values())
    except DataError:
        return None
    whole = all(part.ndim == 2 and part.shape[1] == 3 and np.isfinite(part).all() for part in parts)
    return parts if parts and whole else None


def _write(path: Path, points: list[np.ndarray]) -> None:
    from io import BytesIO

    content = BytesIO()
    np.savez_compressed(content, *points)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, content.getvalue())
