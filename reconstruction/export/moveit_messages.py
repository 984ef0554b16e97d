"""The message types of MoveIt 2 that the scene needs, and messages from plain dicts. Knows ROS 2 types
only."""

from __future__ import annotations

from typing import Any

import numpy as np

POSES = "geometry_msgs/Pose[]"
DEFINITIONS = {
    "object_recognition_msgs/msg/ObjectType": "string key\nstring db",
    "moveit_msgs/msg/CollisionObject": f"""
std_msgs/Header header
geometry_msgs/Pose pose
string id
object_recognition_msgs/ObjectType type
shape_msgs/SolidPrimitive[] primitives
{POSES} primitive_poses
shape_msgs/Mesh[] meshes
{POSES} mesh_poses
shape_msgs/Plane[] planes
{POSES} plane_poses
string[] subframe_names
{POSES} subframe_poses
byte ADD=0
byte REMOVE=1
byte APPEND=2
byte MOVE=3
byte operation""",
    "moveit_msgs/msg/AttachedCollisionObject": """
string link_name
moveit_msgs/CollisionObject object
string[] touch_links
trajectory_msgs/JointTrajectory detach_posture
float64 weight""",
    "moveit_msgs/msg/RobotState": """
sensor_msgs/JointState joint_state
sensor_msgs/MultiDOFJointState multi_dof_joint_state
moveit_msgs/AttachedCollisionObject[] attached_collision_objects
bool is_diff""",
    "moveit_msgs/msg/AllowedCollisionEntry": "bool[] enabled",
    "moveit_msgs/msg/AllowedCollisionMatrix": """
string[] entry_names
moveit_msgs/AllowedCollisionEntry[] entry_values
string[] default_entry_names
bool[] default_entry_values""",
    "moveit_msgs/msg/LinkPadding": "string link_name\nfloat64 padding",
    "moveit_msgs/msg/LinkScale": "string link_name\nfloat64 scale",
    "moveit_msgs/msg/ObjectColor": "string id\nstd_msgs/ColorRGBA color",
    "octomap_msgs/msg/Octomap": """
std_msgs/Header header
bool binary
string id
float64 resolution
int8[] data""",
    "octomap_msgs/msg/OctomapWithPose": """
std_msgs/Header header
geometry_msgs/Pose origin
octomap_msgs/Octomap octomap""",
    "moveit_msgs/msg/PlanningSceneWorld": """
moveit_msgs/CollisionObject[] collision_objects
octomap_msgs/OctomapWithPose octomap""",
    "moveit_msgs/msg/PlanningScene": """
string name
moveit_msgs/RobotState robot_state
string robot_model_name
geometry_msgs/TransformStamped[] fixed_frame_transforms
moveit_msgs/AllowedCollisionMatrix allowed_collision_matrix
moveit_msgs/LinkPadding[] link_padding
moveit_msgs/LinkScale[] link_scale
moveit_msgs/ObjectColor[] object_colors
moveit_msgs/PlanningSceneWorld world
bool is_diff""",
}
"""Interface definitions of moveit_msgs as of ROS 2 Humble and later."""


def typestore() -> Any:
    """The types of ROS 2 Humble with MoveIt's."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return store


def encode(store: Any, kind: str, content: dict[str, Any]) -> Any:
    """A message of a type from a dict of its fields; fields left out are empty, quaternions left out are
    1."""
    if kind == "geometry_msgs/msg/Quaternion" and not content:
        content = {"w": 1.0}
    _, fields = store.fielddefs[kind]
    values = {name: _value(store, kind_of, content.get(name)) for name, kind_of in fields}
    return store.types[kind](**values)


def _value(store: Any, kind: tuple[Any, Any], content: Any) -> Any:
    """A field's value; kind is rosbags' description: (what, details)."""
    from rosbags.interfaces import Nodetype

    what, details = kind
    if what == Nodetype.BASE:
        name, _ = details
        return {"string": "", "bool": False}.get(name, 0) if content is None else content
    if what == Nodetype.NAME:
        return encode(store, details, content or {})
    (inner, inner_details), length = details[0], details[1]
    content = [] if content is None else content
    if inner == Nodetype.BASE and inner_details[0] != "string":
        size = length if what == Nodetype.ARRAY and not len(content) else None
        dtype = np.dtype({"byte": "uint8", "octet": "uint8", "char": "uint8"}.get(*[inner_details[0]] * 2))
        return np.zeros(size, dtype) if size else np.asarray(content, dtype)
    return [_value(store, (inner, inner_details), item) for item in content]
