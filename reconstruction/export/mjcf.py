"""MuJoCo: scene.xml with a free body an object, inertia from its mesh, collisions from its convex parts."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as xml

import numpy as np

from reconstruction.export.export_object import ExportObject
from reconstruction.export.export_scene import ExportScene
from reconstruction.files.mesh_files import encode_obj

GRAVITY = 9.81
"""[m/s^2], along the support's normal, downwards."""
TURNING = 0.005
"""Friction against turning on the spot [m]."""
CONTACT = "6"
"""MuJoCo's contacts that resist sliding, turning and rolling."""
STIFF = "0.005 1"
"""Time constant [s] and damping of MuJoCo's contacts. With its default of 0.02 s a body sinks in by half a
millimetre, and what stands on less than a centimetre leans until it falls."""
GAP = 0.0
"""Between parts of two objects [m]: MuJoCo keeps nothing around them."""
SEEN_GROUP, CONVEX_GROUP = "2", "3"
"""MuJoCo's viewer shows group 2 and hides group 3."""
STATEMENT = {
    "frame": "bodies in the world frame of the result, meshes in each object's own frame",
    "unit": "m, kg",
    "quaternion": "w x y z",
    "friction": "of geoms: sliding, turning [m], rolling [m]; a ball rolls where the slope is more than "
    "rolling / its radius",
}


def write(scene: ExportScene, folder: Path) -> None:
    """scene.xml and meshes/<key>.obj, meshes/<key>_<i>.obj."""
    root = xml.Element("mujoco", model="contramap_scene")
    root.append(xml.Comment(" world frame, m, kg, quaternions w x y z "))
    xml.SubElement(root, "compiler", meshdir="meshes", angle="radian")
    # Round things and stacks stay where they were seen: contacts resist rolling, and sliding is stiff.
    xml.SubElement(root, "option", gravity=_numbers(-GRAVITY * scene.up), cone="elliptic", impratio="10")
    # Up to a hundred small parts an object: memory for their contacts.
    xml.SubElement(root, "size", memory="256M")
    assets, world = xml.SubElement(root, "asset"), xml.SubElement(root, "worldbody")
    if scene.support_found:
        _support(world, scene)
    (folder / "meshes").mkdir()
    for item in scene.objects:
        _body(item, scene, assets, world, folder / "meshes")
        _unseen_support(item, scene, world)
    xml.indent(root)
    xml.ElementTree(root).write(folder / "scene.xml", encoding="utf-8", xml_declaration=True)


def _support(world: xml.Element, scene: ExportScene) -> None:
    xml.SubElement(
        world,
        "geom",
        name="support",
        type="plane",
        size="1 1 0.05",
        pos=_numbers(scene.T_world_table[:3, 3]),
        quat=_numbers(scene.bodies(GAP).table_wxyz),
        friction=_friction(scene),
        condim=CONTACT,
        solref=STIFF,
    )


def _unseen_support(item: ExportObject, scene: ExportScene, world: xml.Element) -> None:
    """Fixed boxes: what holds an object up is not known to move."""
    for index, (position, wxyz, size) in enumerate(scene.bodies(GAP).unseen_blocks(item.label)):
        xml.SubElement(
            world,
            "geom",
            name=f"{item.key}_unseen_support_{index:02d}",
            type="box",
            size=_numbers(size / 2),
            pos=_numbers(position),
            quat=_numbers(wxyz),
            group=CONVEX_GROUP,
            friction=_friction(scene),
            condim=CONTACT,
            solref=STIFF,
        )


def _body(
    item: ExportObject, scene: ExportScene, assets: xml.Element, world: xml.Element, folder: Path
) -> None:
    body = xml.SubElement(
        world,
        "body",
        name=item.key,
        pos=_numbers(np.array(item.position)),
        quat=_numbers(np.array(item.quaternion_wxyz)),
    )
    xml.SubElement(body, "freejoint", name=item.key)
    mass, even, tensor = item.inertia(scene.config.density)
    centre = scene.bodies(GAP).centres[item.label]
    if not np.allclose(centre, even, rtol=0, atol=1e-6):
        # Where the mesh's own centre of mass would let it fall.
        turning = [tensor[a, b] for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        values = " ".join(f"{value:.9g}" for value in turning)
        xml.SubElement(body, "inertial", pos=_numbers(centre), mass=f"{mass:.9g}", fullinertia=values)
    (folder / f"{item.key}.obj").write_bytes(encode_obj(item.mesh))
    xml.SubElement(assets, "mesh", name=item.key, file=f"{item.key}.obj", inertia="exact")
    xml.SubElement(
        body,
        "geom",
        name=item.key,
        type="mesh",
        mesh=item.key,
        density=f"{scene.config.density:g}",
        contype="0",
        conaffinity="0",
        group=SEEN_GROUP,
    )
    for index, part in enumerate(scene.bodies(GAP).parts[item.label].parts):
        name = f"{item.key}_{index:03d}"
        (folder / f"{name}.obj").write_bytes(encode_obj(part.mesh))
        # Parts have no mass of their own, and thin ones hardly a volume.
        xml.SubElement(assets, "mesh", name=name, file=f"{name}.obj", inertia="shell")
        xml.SubElement(
            body,
            "geom",
            name=name,
            type="mesh",
            mesh=name,
            mass="0",
            group=CONVEX_GROUP,
            friction=_friction(scene),
            condim=CONTACT,
            solref=STIFF,
        )


def _friction(scene: ExportScene) -> str:
    """Sliding, turning [m] and rolling [m]."""
    return f"{scene.config.friction:g} {TURNING:g} {scene.config.rolling:g}"


def _numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:.9f}" for value in values)
