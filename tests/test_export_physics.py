"""Exported objects in physics: open containers hold a ball, what was seen at rest stays at rest."""

from __future__ import annotations

import dataclasses
import json
from xml.etree import ElementTree as xml

import numpy as np
import pytest
import trimesh
from planner_scene import MUG_HEIGHT, PlannerScene, planner_scene

from reconstruction.export import mjcf, urdf, usd
from reconstruction.export.collision import ConvexParts
from reconstruction.export.export_scene import ExportScene
from reconstruction.export.footing import with_footing
from reconstruction.export.formats import export
from reconstruction.export.hulls import Hull
from sim_scenes.tabletop import quiet_stdout
from tools import export_checks
from tools.ball_drops import CELL, Hollow, covered, drop_all, hollow
from tools.export_checks import overlap, stand, summarise


@pytest.fixture(scope="module")
def planned(tmp_path_factory) -> PlannerScene:
    return planner_scene(tmp_path_factory.mktemp("result"))


@pytest.fixture(scope="module")
def out(planned, tmp_path_factory):
    folder = tmp_path_factory.mktemp("exports")
    export(planned.scene(), ["urdf", "mjcf"], folder)
    return folder


def test_a_ball_dropped_into_the_mug_stays_there(planned, tmp_path):
    pytest.importorskip("mujoco")
    pytest.importorskip("pybullet")
    drops = drop_all(planned.scene(), tmp_path)
    assert [(drop.key, drop.engine) for drop in drops] == [("1_mug", "mujoco"), ("1_mug", "pybullet")]
    assert all(drop.held for drop in drops)
    assert drops[0].depth == pytest.approx(MUG_HEIGHT, abs=0.02)


def test_what_holds_water_is_a_container_and_nothing_else():
    x, y = np.meshgrid(np.arange(-0.05, 0.05, CELL), np.arange(-0.05, 0.05, CELL), indexing="ij")
    radius = np.hypot(x, y)
    bowl = np.where(radius < 0.045, np.where(radius < 0.04, 0.01, 0.06), -np.inf)
    found = hollow(bowl, np.array([-0.05, -0.05]))
    assert found.top == pytest.approx(0.06)
    assert found.depth == pytest.approx(0.05)
    assert found.middle == pytest.approx((0, 0), abs=2 * CELL)
    assert found.radius == pytest.approx(0.04, abs=2 * CELL)
    spout = bowl.copy()
    spout[x > 0.02] = np.minimum(spout[x > 0.02], 0.02)  # water runs out at one side: 1 cm is left
    assert hollow(spout, np.zeros(2)) is None
    assert hollow(np.full((50, 50), 0.1), np.zeros(2)) is None


def test_a_container_with_something_in_or_above_it_is_left_out():
    place = Hollow((0.0, 0.0), 0.03, 0.1, 0.08)
    lid = trimesh.creation.box((0.02, 0.02, 0.02))
    assert covered(place, [lid.copy().apply_translation([0.005, 0, 0.3])])
    assert covered(place, [lid.copy().apply_translation([0, 0, 0.05])])
    assert not covered(place, [lid.copy().apply_translation([0, 0, 0.0])])  # below its bottom
    assert not covered(place, [lid.copy().apply_translation([0.05, 0, 0.3])])
    assert not covered(place, [])


def test_nothing_reaches_into_the_support_and_the_foot_is_flat(planned):
    bodies = (scene := planned.scene()).bodies(urdf.GAP)
    for item in scene.objects:
        low = item.solid.bounds[0, 2]
        corners = np.concatenate([part.vertices for part in bodies.parts[item.label].parts])
        assert corners[:, 2].min() == pytest.approx(low, abs=1e-6)
        assert bodies.parts[item.label].error_m < 3e-3
    ball = trimesh.creation.icosphere(3, 0.04)
    whole = ConvexParts((Hull.of(ball),), ball)
    cut = with_footing(whole, ball, -0.039)
    assert np.concatenate([part.vertices for part in cut.parts])[:, 2].min() == pytest.approx(-0.039)
    foot = cut.parts[0].vertices[:, 2] < -0.0389
    assert np.ptp(cut.parts[0].vertices[foot][:, 0]) > 0.015
    assert cut.error_m < 3e-3
    assert with_footing(whole, ball, -0.06) is whole


def test_what_stood_stays_standing(planned, out):
    pytest.importorskip("mujoco")
    pytest.importorskip("pybullet")
    motions = list(stand(planned.result.folder, out))
    assert len(motions) == 4
    assert all(motion.rested for motion in motions), motions
    said = {name: json.loads((out / name / "export.json").read_text()) for name in ("urdf", "mjcf")}
    collision = {name: of_one["collision"] for name, of_one in said.items()}
    none = {name: [] for name in said}
    figures = [
        {"seconds": 1.0, "overlap_mm": 1e3 * overlap(out), "collision": collision, "unseen_supports": none}
    ]
    summary = summarise(figures, motions)
    assert summary["mujoco_at_rest"] == summary["pybullet_at_rest"] == 1.0
    assert summary["urdf_error_mm_max"] < 3
    assert summary["mjcf_error_mm_max"] < 3
    assert 0 <= summary["overlap_mm_max"] < 2


def test_what_hovers_over_hidden_space_rests_on_unseen_supports(planned, tmp_path):
    """The mug, its lower end guessed away: below it lies what was behind its seen side."""
    pytest.importorskip("mujoco")
    pytest.importorskip("pybullet")
    mug, bracket = planned.result.objects
    lift = planned.scene().up * 0.03
    T = mug.T_world_object.copy()
    T[:3, 3] += lift
    lifted = dataclasses.replace(mug, mesh=mug.mesh.copy().apply_translation(lift), T_world_object=T)
    scene = ExportScene(dataclasses.replace(planned.result, objects=(lifted, bracket)))
    export(scene, ["urdf", "mjcf", "usd"], tmp_path)
    for name, gap in (("urdf", urdf.GAP), ("mjcf", mjcf.GAP), ("usd", usd.GAP)):
        supports = scene.bodies(gap).unseen_supports
        assert list(supports) == [1]
        said = json.loads((tmp_path / name / "export.json").read_text())["unseen_supports"]
        assert list(said) == ["1_mug"]
        assert said["1_mug"]["blocks"] == len(supports[1]) >= 3
    motions = list(stand(planned.result.folder, tmp_path))
    assert {motion.key for motion in motions} == {"1_mug", "2_bracket"}
    assert all(motion.rested for motion in motions), motions
    assert overlap(tmp_path) < 0.002
    text = (tmp_path / "usd" / "scene.usda").read_text()
    assert text.count("def Cube") == len(supports[1])
    (tmp_path / "urdf" / "unseen_supports.urdf").unlink()
    before, after = export_checks._pybullet(tmp_path)["1_mug"]
    assert np.linalg.norm(after[:3, 3] - before[:3, 3]) > 0.02  # without them it falls


@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_a_ball_with_the_exported_friction_stays_on_the_level_and_rolls_down_a_slope(out, tmp_path, engine):
    """Rolling friction is a length: a ball of 2 cm radius stays up to atan(2 mm / 2 cm), 5.7 degrees, in
    MuJoCo; pybullet multiplies it by the other's sliding friction, 0.5."""
    pytest.importorskip(engine)
    roll = {"mujoco": _rolled_in_mujoco, "pybullet": _rolled_in_pybullet}[engine]
    assert abs(roll(out, tmp_path, 0.0, 0.0)) < 1e-3
    assert 1e-3 < roll(out, tmp_path, 0.0, 0.05) < 0.01  # pushed at 5 cm/s, it stops
    assert abs(roll(out, tmp_path, 2.0, 0.0)) < 5e-3
    assert roll(out, tmp_path, 10.0, 0.0) > 0.5


def _rolled_in_mujoco(out, tmp_path, degrees: float, speed: float) -> float:
    """How far a ball of 2 cm radius with the friction of an exported part rolls in 2 s [m]."""
    import mujoco

    root = xml.parse(out / "mjcf" / "scene.xml").getroot()
    (support,) = root.findall("worldbody/geom[@name='support']")
    part = root.find("worldbody/body/geom[@group='3']")
    kept = ("friction", "condim", "solref")
    geoms = [" ".join(f'{name}="{geom.get(name)}"' for name in kept) for geom in (support, part)]
    down = 9.81 * np.array([np.sin(np.radians(degrees)), 0, -np.cos(np.radians(degrees))])
    option = root.find("option")
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option gravity="{down[0]} 0 {down[2]}" cone="{option.get("cone")}" '
        f'impratio="{option.get("impratio")}"/><worldbody><geom type="plane" size="9 9 1" {geoms[0]}/>'
        f'<body pos="0 0 0.02"><freejoint/><geom type="sphere" size="0.02" mass="0.02" {geoms[1]}/></body>'
        "</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    data.qvel[[0, 4]] = speed, speed / 0.02
    for _ in range(round(2.0 / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return float(data.qpos[0])


def _rolled_in_pybullet(out, tmp_path, degrees: float, speed: float) -> float:
    """The same."""
    with quiet_stdout():
        import pybullet as bullet
    robot = xml.parse(out / "urdf" / "1_mug.urdf").getroot()
    link = robot.find("link")
    for old in [*link.findall("collision"), *link.findall("visual")]:
        link.remove(old)
    shape = xml.SubElement(xml.SubElement(link, "collision"), "geometry")
    xml.SubElement(shape, "sphere", radius="0.02")
    link.find("inertial/origin").set("xyz", "0 0 0")
    link.find("inertial/mass").set("value", "0.02")
    turning = {"ixx": "3.2e-6", "iyy": "3.2e-6", "izz": "3.2e-6", "ixy": "0", "ixz": "0", "iyz": "0"}
    link.find("inertial/inertia").attrib.update(turning)
    xml.ElementTree(robot).write(tmp_path / "ball.urdf")
    client = bullet.connect(bullet.DIRECT)
    try:
        tilt = np.radians(degrees)
        bullet.setGravity(9.81 * np.sin(tilt), 0, -9.81 * np.cos(tilt), physicsClientId=client)
        plane = bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=[9, 9, 1], physicsClientId=client)
        bullet.createMultiBody(0, plane, -1, [0, 0, -1], physicsClientId=client)
        ball = bullet.loadURDF(str(tmp_path / "ball.urdf"), [0, 0, 0.02], physicsClientId=client)
        bullet.resetBaseVelocity(ball, [speed, 0, 0], [0, speed / 0.02, 0], physicsClientId=client)
        for _ in range(480):
            bullet.stepSimulation(physicsClientId=client)
        return float(bullet.getBasePositionAndOrientation(ball, physicsClientId=client)[0][0])
    finally:
        bullet.disconnect(client)
