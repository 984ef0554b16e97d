"""OBJ: one mesh an object in the world frame, where it was seen, and poses.json."""

from __future__ import annotations

from pathlib import Path

from reconstruction.export.export_object import moved
from reconstruction.export.export_scene import ExportScene
from reconstruction.export.poses import write_poses
from reconstruction.files.mesh_files import encode_obj

STATEMENT = {
    "frame": "world frame of the result",
    "unit": "m",
    "quaternion": "poses.json says its order in the key: quaternion_xyzw",
}


def write(scene: ExportScene, folder: Path) -> None:
    """<key>.obj of each object and obstacle (inflated, when that was asked for) and poses.json."""
    for item in scene.obstacles:
        (folder / f"{item.key}.obj").write_bytes(encode_obj(moved(item.solid, item.T_world_object)))
    write_poses(scene, folder / "poses.json")
