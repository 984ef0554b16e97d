"""poses.json: where the objects of an export are, in one place and in words. Knows poses, no format."""

from __future__ import annotations

import json
from pathlib import Path

from reconstruction.export.export_scene import ExportScene


def write_poses(scene: ExportScene, path: Path) -> None:
    """Position [m], quaternions in both orders and T_world_object (4, 4) of each object, and the way up."""
    content = {
        "frame": "world",
        "unit": "m",
        "up": scene.up.tolist(),
        "support": _support(scene),
        "objects": {
            item.key: {
                "position": item.position,
                "quaternion_xyzw": item.quaternion_xyzw,
                "quaternion_wxyz": item.quaternion_wxyz,
                "T_world_object": item.T_world_object.tolist(),
                "extents": item.extents.tolist(),
            }
            for item in scene.objects
        },
    }
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _support(scene: ExportScene) -> dict[str, list[float]] | None:
    """A point of the support plane, and the turn whose z axis is its normal; None when none was found."""
    if not scene.support_found:
        return None
    from scipy.spatial.transform import Rotation

    T = scene.T_world_table
    turn = Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True)
    return {"position": T[:3, 3].tolist(), "quaternion_xyzw": turn.tolist()}
