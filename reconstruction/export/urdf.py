"""URDF: one file an object, a body free to move, and scene.urdf, where all stand fixed in the world frame."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as xml

import numpy as np

from reconstruction.export.export_object import ExportObject
from reconstruction.export.export_scene import ExportConfig, ExportScene
from reconstruction.export.hulls import Hull
from reconstruction.export.poses import write_poses
from reconstruction.files.mesh_files import encode_obj

STATEMENT = {
    "frame": "meshes, inertia and links in each object's own frame; poses.json and scene.urdf hold their "
    "poses "
    "in the world frame of the result",
    "unit": "m, kg, rad",
    "quaternion": "poses.json says its order in the key: quaternion_xyzw; scene.urdf has fixed-axis roll "
    "pitch yaw",
    "friction": "contact, read by pybullet: lateral_friction, rolling_friction [m], spinning_friction [m]",
}

UNSEEN = "unseen_supports.urdf"
GAP = 0.002
"""Between parts of two objects [m]: pybullet keeps 1 mm around either, which no tag of URDF changes, and
throws objects over that are nearer: 13 of 74 with 1.4 mm."""


def write(scene: ExportScene, folder: Path) -> None:
    """<key>.urdf, meshes/<key>/visual.obj and part_<i>.obj, scene.urdf and poses.json."""
    whole = xml.Element("robot", name="contramap_scene")
    whole.append(xml.Comment(" world frame, m, kg; rpy about fixed axes [rad] "))
    xml.SubElement(whole, "link", name="world")
    for item in scene.objects:
        parts = scene.bodies(GAP).parts[item.label].parts
        _write_meshes(item, parts, folder / "meshes" / item.key)
        single = xml.Element("robot", name=item.key)
        single.append(xml.Comment(" object frame, m, kg; the pose in the world is in poses.json "))
        for robot in (single, whole):
            robot.append(_link(item, len(parts), scene.bodies(GAP).centres[item.label], scene.config))
        _save(single, folder / f"{item.key}.urdf")
        whole.append(_fixed_joint(item))
    _save(whole, folder / "scene.urdf")
    if scene.bodies(GAP).unseen_supports:
        _save(_unseen_supports(scene), folder / UNSEEN)
    write_poses(scene, folder / "poses.json")


def _unseen_supports(scene: ExportScene) -> xml.Element:
    """A link of mass 0, which engines keep where it is, with fixed boxes in the world frame."""
    from scipy.spatial.transform import Rotation

    robot = xml.Element("robot", name="unseen_supports")
    robot.append(xml.Comment(" world frame, m; what must hold up objects that stand on nothing known "))
    link = xml.SubElement(robot, "link", name="unseen_supports")
    inertial = xml.SubElement(link, "inertial")
    xml.SubElement(inertial, "mass", value="0")
    xml.SubElement(inertial, "inertia", {f"i{pair}": "0" for pair in ("xx", "xy", "xz", "yy", "yz", "zz")})
    contact = xml.SubElement(link, "contact")
    xml.SubElement(contact, "lateral_friction", value=f"{scene.config.friction:g}")
    angles = Rotation.from_matrix(scene.T_world_table[:3, :3]).as_euler("xyz")
    for item in scene.objects:
        for index, (position, _, size) in enumerate(scene.bodies(GAP).unseen_blocks(item.label)):
            shape = xml.SubElement(link, "collision", name=f"{item.key}_{index:02d}")
            xml.SubElement(shape, "origin", xyz=_numbers(position), rpy=_numbers(angles))
            xml.SubElement(xml.SubElement(shape, "geometry"), "box", size=_numbers(size))
    return robot


def _write_meshes(item: ExportObject, parts: tuple[Hull, ...], folder: Path) -> None:
    folder.mkdir(parents=True)
    (folder / "visual.obj").write_bytes(encode_obj(item.mesh))
    for index, part in enumerate(parts):
        (folder / f"part_{index:03d}.obj").write_bytes(encode_obj(part.mesh))


def _link(item: ExportObject, parts: int, centre: np.ndarray, config: ExportConfig) -> xml.Element:
    link = xml.Element("link", name=item.key)
    mass, _, tensor = item.inertia(config.density)
    inertial = xml.SubElement(link, "inertial")
    xml.SubElement(inertial, "origin", xyz=_numbers(centre), rpy="0 0 0")
    xml.SubElement(inertial, "mass", value=f"{mass:.9g}")
    values = {
        f"i{'xyz'[a]}{'xyz'[b]}": f"{tensor[a, b]:.9g}"
        for a, b in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    }
    xml.SubElement(inertial, "inertia", values)
    # Read by pybullet, passed over by others.
    contact = xml.SubElement(link, "contact")
    xml.SubElement(contact, "lateral_friction", value=f"{config.friction:g}")
    xml.SubElement(contact, "rolling_friction", value=f"{config.rolling:g}")
    xml.SubElement(contact, "spinning_friction", value=f"{config.rolling:g}")
    _geometry(link, "visual", f"meshes/{item.key}/visual.obj")
    for index in range(parts):
        _geometry(link, "collision", f"meshes/{item.key}/part_{index:03d}.obj")
    return link


def _geometry(link: xml.Element, kind: str, file: str) -> None:
    shape = xml.SubElement(link, kind)
    xml.SubElement(shape, "origin", xyz="0 0 0", rpy="0 0 0")
    xml.SubElement(xml.SubElement(shape, "geometry"), "mesh", filename=file)


def _fixed_joint(item: ExportObject) -> xml.Element:
    from scipy.spatial.transform import Rotation

    joint = xml.Element("joint", name=f"world_to_{item.key}", type="fixed")
    xml.SubElement(joint, "parent", link="world")
    xml.SubElement(joint, "child", link=item.key)
    angles = Rotation.from_matrix(item.T_world_object[:3, :3]).as_euler("xyz")
    xml.SubElement(joint, "origin", xyz=_numbers(item.position), rpy=_numbers(angles))
    return joint


def _numbers(values: np.ndarray | list[float]) -> str:
    return " ".join(f"{value:.9f}" for value in values)


def _save(robot: xml.Element, path: Path) -> None:
    xml.indent(robot)
    xml.ElementTree(robot).write(path, encoding="utf-8", xml_declaration=True)
