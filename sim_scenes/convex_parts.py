"""Collision shapes: a mesh as a few convex parts (coacd), cached by the mesh's content.

coacd runs in a process of its own: it can be stopped when it takes too long, several run side by side, and its
library and open3d's cannot be loaded into one process in either order.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import trimesh

from sim_scenes.cache import cache_dir
from sim_scenes.object_model import ObjectModel


@dataclass(frozen=True)
class ConvexConfig:
    """How finely a mesh is cut into convex parts for physics."""

    faces: int = 1000
    """Triangles left by simplification before cutting."""
    threshold: float = 0.06
    """Largest concavity of a part, relative to the object's size; small enough to keep cups hollow."""
    parts: int = 24
    """Most convex parts an object is cut into."""
    time_limit_s: float = 60.0
    """Seconds after which an object falls back to its convex hull."""


def collision_file(model: ObjectModel, config: ConvexConfig | None = None) -> Path:
    """OBJ file whose groups are the convex parts [m], in the object's frame moved to its centre of mass.

    Computed once per mesh content and settings, then read from the cache folder.
    """
    config = config or ConvexConfig()
    path = _cached_path(model, config)
    if not path.is_file():
        parts = _decompose(model.mesh, config)
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
        with os.fdopen(handle, "w") as stream:
            stream.write(_as_obj([part - model.center_of_mass for part in parts]))
        os.replace(temporary, path)
    return path


def build_all(
    models: Sequence[ObjectModel], config: ConvexConfig | None = None, progress: bool = True
) -> None:
    """Fill the cache for all models, as many at a time as there are processors."""
    from tqdm import tqdm

    config = config or ConvexConfig()
    missing = [model for model in models if not _cached_path(model, config).is_file()]
    if not missing:
        return
    with ThreadPoolExecutor(max_workers=os.cpu_count() or 1) as pool:
        jobs = pool.map(lambda model: collision_file(model, config), missing)
        list(tqdm(jobs, total=len(missing), desc="collision shapes", disable=not progress))


def _cached_path(model: ObjectModel, config: ConvexConfig) -> Path:
    digest = hashlib.sha256(repr(sorted(asdict(config).items())).encode())
    digest.update(np.ascontiguousarray(model.mesh.vertices, np.float32).tobytes())
    digest.update(np.ascontiguousarray(model.mesh.faces, np.int64).tobytes())
    return cache_dir() / "convex_parts" / f"{digest.hexdigest()[:32]}.obj"


def _decompose(mesh: trimesh.Trimesh, config: ConvexConfig) -> list[np.ndarray]:
    """Vertices (N, 3) of each convex part."""
    hull = mesh.convex_hull
    if mesh.volume > 0.97 * hull.volume:  # convex already: balls, boxes, cans
        return [np.asarray(hull.vertices)]
    simple = _simplify(mesh, config.faces)
    with tempfile.TemporaryDirectory() as folder:
        given, found = Path(folder) / "mesh.npz", Path(folder) / "parts.npz"
        np.savez(given, vertices=simple.vertices, faces=simple.faces)
        repository = str(Path(__file__).resolve().parent.parent)
        command = [sys.executable, "-m", "sim_scenes.convex_parts", given, found]
        command += [str(config.threshold), str(config.parts)]
        environment = {**os.environ, "OMP_NUM_THREADS": "1"}
        environment["PYTHONPATH"] = os.pathsep.join([repository, os.environ.get("PYTHONPATH", "")])
        try:
            subprocess.run(
                command, env=environment, timeout=config.time_limit_s, check=True, capture_output=True
            )
        except (subprocess.TimeoutExpired, subprocess.CalledProcessError):
            return [np.asarray(hull.vertices)]
        with np.load(found) as parts:
            return [parts[key] for key in sorted(parts.files)]


def _simplify(mesh: trimesh.Trimesh, faces: int) -> trimesh.Trimesh:
    import open3d

    if len(mesh.faces) <= faces:
        return mesh
    full = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(np.asarray(mesh.vertices)),
        open3d.utility.Vector3iVector(np.asarray(mesh.faces)),
    )
    simple = full.simplify_quadric_decimation(faces)
    return trimesh.Trimesh(np.asarray(simple.vertices), np.asarray(simple.triangles))


def _as_obj(parts: list[np.ndarray]) -> str:
    lines: list[str] = []
    offset = 1
    for index, points in enumerate(parts):
        hull = trimesh.convex.convex_hull(points)
        lines.append(f"o part_{index}")
        lines += [f"v {x:.7f} {y:.7f} {z:.7f}" for x, y, z in hull.vertices]
        lines += [f"f {a} {b} {c}" for a, b, c in np.asarray(hull.faces) + offset]
        offset += len(hull.vertices)
    return "\n".join(lines) + "\n"


def _cut(given: str, found: str, threshold: float, parts: int) -> None:
    """Runs in the child process: coacd on the mesh in `given`, the parts to `found`."""
    import coacd

    coacd.set_log_level("error")
    mesh = np.load(given)
    cut = coacd.run_coacd(
        coacd.Mesh(mesh["vertices"], mesh["faces"]),
        threshold=threshold,
        max_convex_hull=parts,
        preprocess_mode="auto",
        preprocess_resolution=30,
        resolution=500,
        mcts_iterations=20,
        mcts_nodes=8,
        mcts_max_depth=2,
    )
    np.savez(found, **{f"{index:04d}": vertices for index, (vertices, _) in enumerate(cut)})


if __name__ == "__main__":
    _cut(sys.argv[1], sys.argv[2], float(sys.argv[3]), int(sys.argv[4]))
