"""cuRobo: world configurations as YAML, one of meshes and one of the objects' boxes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.export.export_object import ExportObject
from reconstruction.export.export_scene import ExportScene

STATEMENT = {
    "frame": "world frame of the result (give the robot's base as cuRobo's world); vertices in each "
    "object's frame",
    "unit": "m",
    "quaternion": "pose: x y z qw qx qy qz",
    "cache": "cuRobo needs a cache for a world of meshes: collision_cache={'mesh': 32, 'obb': 32}",
}


def write(scene: ExportScene, folder: Path) -> None:
    """world_mesh.yml and world_cuboid.yml."""
    meshes = {item.key: {"pose": _pose(item), **_mesh(item)} for item in scene.obstacles}
    boxes = {item.key: _box(item) for item in scene.obstacles}
    (folder / "world_mesh.yml").write_text(_yaml("mesh", meshes), encoding="utf-8")
    (folder / "world_cuboid.yml").write_text(_yaml("cuboid", boxes), encoding="utf-8")


def _pose(item: ExportObject) -> list[float]:
    return [*item.position, *item.quaternion_wxyz]


def _mesh(item: ExportObject) -> dict[str, Any]:
    return {
        "vertices": np.asarray(item.solid.vertices).round(6).tolist(),
        "faces": np.asarray(item.solid.faces).tolist(),
    }


def _box(item: ExportObject) -> dict[str, Any]:
    """The box around the solid along the object's axes; its middle is not the object's origin once
    inflated."""
    low, high = item.solid.bounds
    T = item.T_world_object
    middle = T[:3, :3] @ ((low + high) / 2) + T[:3, 3]
    return {"dims": (high - low).tolist(), "pose": [*middle.tolist(), *item.quaternion_wxyz]}


def _yaml(kind: str, entries: dict[str, Any]) -> str:
    """An entry a line, in flow style: YAML, and written a hundred times faster than in block style."""
    lines = "".join(f"  {json.dumps(key)}: {json.dumps(value)}\n" for key, value in entries.items())
    return f"# cuRobo world; world frame, m; pose x y z qw qx qy qz\n{kind}:\n{lines}"
