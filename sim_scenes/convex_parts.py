"""Collision shapes: a mesh as a few convex parts (V-HACD), cached by the mesh's content.

V-HACD works on voxels: a second or two for a scan, whatever its triangles look like. It runs in a process of
its own, so that it can be stopped, several run side by side, and what it prints does not reach the user.
"""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError

from mapping.errors import DataError
from mapping.files import cache_dir, temporary_beside
from mapping.folders import temporary_folder
from mapping.parent import end_with_parent
from perception.ray_casting import ray_scene, tensor
from sim_scenes.objects.decimation import decimated
from sim_scenes.objects.object_model import ObjectModel

END = "# end\n"
"""The last line of a file of parts: one without it was cut."""
LAYOUT = 2
"""Raised when files of parts change: older ones are made again."""
ATTEMPTS = 2


@dataclass(frozen=True)
class ConvexConfig:
    """How finely a mesh is cut into convex parts for physics."""

    faces: int = 3000
    """Triangles left by simplification before cutting; fewer tear the rims of plates."""
    voxels: int = 50_000
    """Voxels the object is cut on."""
    concavity: float = 0.002
    """Largest concavity of a part, relative to the object's size; small enough to keep cups hollow."""
    convex_above: float = 0.97
    """Objects that fill more than this share of their convex hull are taken as convex."""
    time_limit_s: float = 300.0
    """Seconds after which cutting an object is given up: with another shape in its place, the same seed would
    make another scene."""


def collision_file(model: ObjectModel, config: ConvexConfig | None = None) -> Path:
    """OBJ file whose groups are the convex parts [m], in the object's frame moved to its centre of mass.

    Computed once per mesh content and settings, then read from the cache folder; what is broken there is made
    again. Raises DataError for a mesh that cannot be cut.
    """
    config = config or ConvexConfig()
    path = _cached_path(model, config)
    if not is_whole(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(path) as folder:
            parts = _decompose(model.mesh, config, folder)
        with temporary_beside(path) as partial:
            write_parts(model, parts, partial)
            if not is_whole(partial):
                raise DataError(f"{model.name}: its collision shape holds nothing; is the mesh flat?")
    return path


def is_whole(path: Path) -> bool:
    """Whether a file of parts is complete and finite: the simulator takes a NaN with a crash."""
    try:
        text = path.read_text(encoding="ascii")
        parts = _read_parts(path)
    except (OSError, ValueError, IndexError):
        return False
    return bool(parts) and text.endswith(END) and all(np.isfinite(part).all() for part in parts)


def write_parts(model: ObjectModel, parts: Sequence[np.ndarray], path: Path) -> None:
    """Write parts (N, 3) [m] of a model as groups of an OBJ file, pulled onto its mesh, about its centre."""
    sizes = np.cumsum([len(part) for part in parts])[:-1]
    points = _pull_inside(np.concatenate(parts), model.mesh) - model.center_of_mass
    path.write_text(_as_obj(np.split(points, sizes)))


def build_all(
    models: Sequence[ObjectModel], config: ConvexConfig | None = None, progress: bool = True
) -> None:
    """Fill the cache for all models, as many at a time as there are processors."""
    from tqdm import tqdm

    config = config or ConvexConfig()
    missing = [model for model in models if not (model.parts or is_whole(_cached_path(model, config)))]
    if not missing:
        return
    with ThreadPoolExecutor(max_workers=os.cpu_count() or 1) as pool:
        jobs = pool.map(lambda model: collision_file(model, config), missing)
        list(tqdm(jobs, total=len(missing), desc="collision shapes", disable=not progress))


def _cached_path(model: ObjectModel, config: ConvexConfig) -> Path:
    settings = {name: value for name, value in asdict(config).items() if name != "time_limit_s"}
    digest = hashlib.sha256(repr((LAYOUT, sorted(settings.items()))).encode())
    digest.update(np.ascontiguousarray(model.mesh.vertices, np.float32).tobytes())
    digest.update(np.ascontiguousarray(model.mesh.faces, np.int64).tobytes())
    return cache_dir() / "convex_parts" / f"{digest.hexdigest()[:32]}.obj"


def _decompose(mesh: trimesh.Trimesh, config: ConvexConfig, folder: Path) -> list[np.ndarray]:
    """Vertices (N, 3) of each convex part; `folder` is for what is under way."""
    if not (len(mesh.faces) and np.isfinite(mesh.vertices).all()):
        raise DataError("a mesh without triangles, or with NaN or infinite vertices, has no collision shape")
    hull = mesh.convex_hull
    if mesh.volume > config.convex_above * hull.volume:
        return [np.asarray(hull.vertices)]
    given, found = folder / "mesh.obj", folder / "parts.obj"
    decimated(mesh, config.faces).export(given)
    repository = str(Path(__file__).resolve().parent.parent)
    command = [sys.executable, "-m", "sim_scenes.convex_parts", str(given), str(found)]
    command += [str(config.voxels), str(config.concavity)]
    command += [str(os.getpid())]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    environment["PYTHONPATH"] = os.pathsep.join([repository, os.environ.get("PYTHONPATH", "")])
    for _ in range(ATTEMPTS):
        try:
            ended = subprocess.run(
                command, env=environment, timeout=config.time_limit_s, capture_output=True, text=True
            )
        except (subprocess.TimeoutExpired, OSError) as error:
            raise DataError(f"cutting a mesh into convex parts did not end ({error}); try again") from error
        if ended.returncode == 0 and (parts := _read_parts(found)):
            return parts
    # Whoever was killed says nothing about the mesh; what fails by itself fails always.
    if -ended.returncode in (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        raise DataError("cutting a mesh into convex parts was killed (out of memory?); try again")
    if "ImportError" in ended.stderr or "ModuleNotFoundError" in ended.stderr:
        raise DataError(f"cutting a mesh into convex parts failed: {ended.stderr.strip().splitlines()[-1]}")
    return [np.asarray(hull.vertices)]


def _pull_inside(points: np.ndarray, mesh: trimesh.Trimesh) -> np.ndarray:
    """Points (N, 3) with those outside the mesh moved onto it: voxels stick out, and objects would float."""
    scene, query = ray_scene([(mesh.vertices, mesh.faces)]), tensor(points)
    outside = scene.compute_signed_distance(query).numpy() > 0
    nearest = scene.compute_closest_points(query)["points"].numpy()
    return np.where(outside[:, None], nearest, points)


def _read_parts(path: Path) -> list[np.ndarray]:
    """Vertices of each group of an OBJ file; parts without volume are left out."""
    groups: list[list[list[float]]] = []
    for line in path.read_text().splitlines():
        if line.startswith("o "):
            groups.append([])
        elif line.startswith("v "):
            groups[-1].append([float(value) for value in line.split()[1:4]])
    return [np.array(group) for group in groups if len(group) >= 4]


def _as_obj(parts: list[np.ndarray]) -> str:
    lines: list[str] = []
    offset = 1
    for index, points in enumerate(parts):
        try:
            hull = ConvexHull(points)
        except QhullError:  # flat after it was pulled inside: holds nothing
            continue
        lines.append(f"o part_{index}")
        corners = points[hull.vertices]
        number = np.empty(len(points), int)
        number[hull.vertices] = offset + np.arange(len(corners))
        lines += [f"v {x:.7f} {y:.7f} {z:.7f}" for x, y, z in corners]
        lines += [f"f {a} {b} {c}" for a, b, c in number[hull.simplices]]
        offset += len(corners)
    return "\n".join(lines) + "\n" + END


def _cut(given: str, found: str, voxels: int, concavity: float) -> None:
    """Runs in the child process: V-HACD on the mesh in `given`, the parts to `found`."""
    import pybullet

    pybullet.vhacd(
        given,
        found,
        os.path.join(os.path.dirname(found), "log.txt"),
        resolution=voxels,
        concavity=concavity,
        maxNumVerticesPerCH=32,
        minVolumePerCH=0.0001,
    )


if __name__ == "__main__":
    end_with_parent(int(sys.argv[5]))
    _cut(sys.argv[1], sys.argv[2], int(sys.argv[3]), float(sys.argv[4]))
