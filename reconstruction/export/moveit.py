"""MoveIt 2: the scene as PlanningScene and CollisionObject, as YAML and as ROS 2 messages in an MCAP bag.

An object's pose is written once: in CollisionObject.pose. Its mesh's pose relative to that is the identity,
so that versions that apply both and versions that read only one of them place it alike or say so.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from reconstruction.export.export_object import ExportObject
from reconstruction.export.export_scene import ExportScene
from reconstruction.export.moveit_messages import encode, typestore

ADD = 0
"""CollisionObject.ADD."""
IDENTITY = {
    "position": {"x": 0.0, "y": 0.0, "z": 0.0},
    "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
}
FRAME = "world"
STATEMENT = {
    "frame": f"frame_id {FRAME!r}: the world frame of the result; meshes in each object's own frame, whose "
    "pose is "
    "CollisionObject.pose; mesh_poses are the identity",
    "unit": "m",
    "quaternion": "x y z w",
    "bag": "planning_scene/: topics /planning_scene (moveit_msgs/msg/PlanningScene, is_diff) and "
    "/collision_object (moveit_msgs/msg/CollisionObject), `ros2 bag play planning_scene`",
}


def write(scene: ExportScene, folder: Path) -> None:
    """planning_scene.yaml, and planning_scene/ with an MCAP bag of the same."""
    objects = [_collision_object(item) for item in scene.obstacles]
    content = {"name": "contramap", "world": {"collision_objects": objects}, "is_diff": True}
    # YAML in flow style is JSON: every YAML reader takes it, and it is written a hundred times faster.
    head = (
        f"# moveit_msgs/msg/PlanningScene; {STATEMENT['frame']}; m; quaternions {STATEMENT['quaternion']}\n"
    )
    (folder / "planning_scene.yaml").write_text(head + _flow(content), encoding="utf-8")
    _write_bag(content, objects, folder / "planning_scene")


def _collision_object(item: ExportObject) -> dict[str, Any]:
    """The fields of a CollisionObject that are not empty."""
    x, y, z, w = item.quaternion_xyzw
    position = dict(zip("xyz", item.position))
    return {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": FRAME},
        "pose": {"position": position, "orientation": {"x": x, "y": y, "z": z, "w": w}},
        "id": item.key,
        "type": {"key": item.name, "db": ""},
        "meshes": [
            {
                "triangles": [{"vertex_indices": row} for row in item.solid.faces.tolist()],
                "vertices": [
                    dict(zip("xyz", row)) for row in np.asarray(item.solid.vertices).round(6).tolist()
                ],
            }
        ],
        "mesh_poses": [IDENTITY],
        "operation": ADD,
    }


def _flow(content: dict[str, Any]) -> str:
    """The scene's fields one a line, an object a line."""
    objects = ",\n  ".join(json.dumps(item) for item in content["world"]["collision_objects"])
    name = json.dumps(content["name"])
    return f"name: {name}\nis_diff: true\nworld:\n  collision_objects: [\n  {objects}\n  ]\n"


def _write_bag(content: dict[str, Any], objects: list[dict[str, Any]], folder: Path) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer

    store = typestore()
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        for topic, kind, messages in (
            ("/planning_scene", "moveit_msgs/msg/PlanningScene", [content]),
            ("/collision_object", "moveit_msgs/msg/CollisionObject", objects),
        ):
            connection = bag.add_connection(topic, kind, typestore=store)
            for message in messages:
                bag.write(connection, 0, store.serialize_cdr(encode(store, kind, message), kind))
