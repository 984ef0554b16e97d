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
from typing import Any, Literal

import numpy as np
import trimesh

from mapping.errors import DataError
from mapping.files import cache_dir, write_atomically
from mapping.guarded_files import read_npz
from reconstruction.export.cut_process import CutFailedError, CutProcess, NoProcessError
from reconstruction.export.cut_worker import begin
from reconstruction.export.cutting import Surface
from reconstruction.export.hulls import Hull, convex_hull, surfaces
from reconstruction.export.parts_error import parts_error
from reconstruction.export.refine import bulges, refined
from reconstruction.export.tips import tips
from reconstruction.solid import Solid

Cutter = Literal["halves", "coacd"]
VERSION = "10"
"""Changes when the same mesh would be cut differently by this code."""
SPLINTER = 2e-9
"""Volume of a part, mostly beside its mesh, that bulges though it cannot be cut [m^3]: rather none."""


@dataclass(frozen=True)
class CollisionConfig:
    """How finely a mesh is cut into convex parts."""

    cutter: Cutter = "halves"
    """What makes the first, coarse cuts: halvings as all later ones, or CoACD, which takes half as long again
    and leaves as many parts (1624 and 1555 of 19 objects)."""
    bulge: float = 0.0027
    """A part that reaches further out of the mesh than this is halved, and what of the mesh is further than
    this from any part becomes one [m]."""
    simplify: float = 0.0009
    """The mesh is simplified by this much before it is cut [m]."""
    convex_within: float = 0.002
    """A mesh whose convex hull is nowhere further from it than this is one part [m]."""
    concavity: float = 0.02
    """Largest concavity that CoACD leaves in a part [m]; what bulges is halved afterwards."""
    samples: int = 100
    """Points CoACD measures a part's concavity with; it takes time in proportion."""
    candidates: int = 5
    """Cutting planes that CoACD tries along each axis."""
    iterations: int = 10
    """Rounds of CoACD's search for a cut."""
    seed: int = 0
    """Of CoACD."""
    time_limit_s: float = 120.0
    """Seconds after which an object is cut anew, without CoACD, and then becomes its convex hull."""


@dataclass(frozen=True)
class ConvexParts:
    """Convex hulls whose union stands for a mesh, in the mesh's frame.

    parts: [m]. mesh: what they stand for. note: why they are coarser than asked for, or "".
    cut: what the mesh was cut into, where these differ from it on purpose. missing_m, excess_m: largest
    distance [m] from the mesh's surface to the parts, and of the parts' surface from within the mesh, over
    the sampled points of parts_error; worked out when first asked for.
    """

    parts: tuple[Hull, ...]
    mesh: trimesh.Trimesh
    note: str = ""
    cut: ConvexParts | None = None

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
    workers: int | None = None,
    beside: Sequence[Sequence[trimesh.Trimesh]] | None = None,
) -> list[ConvexParts]:
    """Convex parts of each closed mesh [m]; `done` is called after each.

    workers: processes that cut at a time; one a core by default. The parts do not depend on it. beside: for
    each mesh those that may reach into it, in its frame: there its parts bulge less.
    """
    config = config or CollisionConfig()
    workers = max(1, min(len(meshes), workers or os.cpu_count() or 1))
    idle: SimpleQueue[CutProcess] = SimpleQueue()
    for _ in range(workers):
        idle.put(CutProcess())

    def one(number: int) -> ConvexParts:
        process = idle.get()
        try:
            return _parts_of(meshes[number], config, process, beside[number] if beside else ())
        finally:
            idle.put(process)
            done()

    try:
        # The largest first: the last one to finish decides.
        order = sorted(range(len(meshes)), key=lambda i: -len(meshes[i].faces))
        with ThreadPoolExecutor(workers) as pool:
            found = dict(zip(order, pool.map(one, order)))
    finally:
        for _ in range(workers):
            idle.get().close()
    return [found[i] for i in range(len(meshes))]


def _parts_of(
    mesh: trimesh.Trimesh, config: CollisionConfig, process: CutProcess, beside: Sequence[trimesh.Trimesh]
) -> ConvexParts:
    path = _cached_path([mesh, *beside], config)
    points, note = _read(path), ""
    if points is None:
        solid, hull = Solid(mesh), Hull.of(mesh.convex_hull)
        others = [Solid(other) for other in beside]
        if bulges(surfaces([hull]), solid, config.convex_within, others)[0][0] <= config.convex_within:
            parts = [hull]
        else:
            parts, note = _cut(mesh, solid, config, process, others)
        points = [part.vertices for part in parts]
        if not note:  # what failed this time, on a busy machine perhaps, is not kept
            _write(path, points)
    # Made of the points in either case: the hull of a hull may differ from it in its last bit.
    again = (convex_hull(part) for part in points)
    return ConvexParts(tuple(part for part in again if part is not None), mesh, note)


def _cut(
    mesh: trimesh.Trimesh,
    solid: Solid,
    config: CollisionConfig,
    process: CutProcess,
    beside: Sequence[Solid],
) -> tuple[list[Hull], str]:
    """Convex parts, and why they are not as they were asked for, "" when they are."""

    def finished(begun: Sequence[Surface], halve: Callable[..., list[list[Surface]]]) -> list[Hull]:
        parts = refined(begun, solid, halve, config.bulge, beside, SPLINTER)
        return parts + tips(mesh, parts, config.bulge)

    halved: dict[str, Any] = {"coacd": None, "simplify": config.simplify}
    note = ""
    if config.cutter == "coacd":
        try:
            begun = process.begin(mesh, {**halved, "coacd": _coacd(config)}, config.time_limit_s)
            return finished(begun, process.halve), ""
        except CutFailedError as error:
            note = f"halved without CoACD: {error}"
    for _ in range(2):  # whatever ended a process may have meant another
        try:
            return finished(process.begin(mesh, halved, config.time_limit_s), process.halve), note
        except NoProcessError:
            cutter = begin(np.asarray(mesh.vertices), mesh.faces, halved)
            return finished(cutter.hulls, cutter.halve), note
        except CutFailedError as error:
            failed = f"its convex hull: {error}"
    return [Hull.of(mesh.convex_hull)], failed


def _coacd(config: CollisionConfig) -> dict[str, Any]:
    """CoACD's own words for the settings."""
    return {
        "threshold": config.concavity,
        "real_metric": True,  # the threshold is in metres
        "resolution": config.samples,
        "mcts_nodes": config.candidates,
        "mcts_iterations": config.iterations,
        "mcts_max_depth": 1,
        "merge": False,
        "seed": config.seed,
    }


def _cached_path(meshes: Sequence[trimesh.Trimesh], config: CollisionConfig) -> Path:
    digest = hashlib.sha256(repr((VERSION, sorted(asdict(config).items()))).encode())
    for mesh in meshes:
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
