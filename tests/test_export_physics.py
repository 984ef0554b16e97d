"""Exported objects in physics: open containers hold a ball, what was seen at rest stays at rest."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh
from planner_scene import MUG_HEIGHT, MUG_RADIUS, PlannerScene, planner_scene

from perception.camera import invert_rigid, transform
from reconstruction.export.collision import ConvexParts
from reconstruction.export.footing import with_footing
from reconstruction.export.formats import export
from tools.export_checks import stand, summarise

BALL = 0.01  # radius [m]
SECONDS = 1.5


@pytest.fixture(scope="module")
def planned(tmp_path_factory) -> PlannerScene:
    return planner_scene(tmp_path_factory.mktemp("result"))


@pytest.fixture(scope="module")
def out(planned, tmp_path_factory):
    folder = tmp_path_factory.mktemp("exports")
    export(planned.scene(), ["urdf", "mjcf"], folder)
    return folder


def above_the_mug(planned) -> np.ndarray:
    """A point of the world 5 cm above the mug's rim, a little off its axis."""
    T = planned.result.objects[0].T_world_object
    return T @ [0.01, 0.01, 0.0, 1] + np.append(0.1 * np.array(planned.result.T_world_table)[:3, 2], 0)


def in_the_mug(planned, ball: np.ndarray) -> bool:
    """Whether a ball's centre lies within the mug's hollow (its object frame has the handle on one side)."""
    T_table = invert_rigid(planned.result.T_world_table)
    mug = transform(T_table, np.asarray(planned.meshes[1].vertices))
    local = transform(T_table, ball[None])[0]
    axis = np.array([-0.08, 0.02])
    return bool(np.linalg.norm(local[:2] - axis) < MUG_RADIUS and 0 < local[2] < mug[:, 2].max())


def test_a_ball_dropped_on_the_mug_ends_inside_in_pybullet(planned, out):
    bullet = pytest.importorskip("pybullet")
    client = bullet.connect(bullet.DIRECT)
    try:
        poses = json.loads((out / "urdf" / "poses.json").read_text())
        pose = poses["objects"]["1_mug"]
        bullet.setGravity(*(-9.81 * np.array(poses["up"])), physicsClientId=client)
        bullet.loadURDF(
            str(out / "urdf" / "1_mug.urdf"),
            pose["position"],
            pose["quaternion_xyzw"],
            useFixedBase=True,
            physicsClientId=client,
        )
        shape = bullet.createCollisionShape(bullet.GEOM_SPHERE, radius=BALL, physicsClientId=client)
        ball = bullet.createMultiBody(
            0.01, shape, -1, above_the_mug(planned)[:3].tolist(), physicsClientId=client
        )
        for _ in range(int(240 * SECONDS)):
            bullet.stepSimulation(physicsClientId=client)
        place = np.array(bullet.getBasePositionAndOrientation(ball, physicsClientId=client)[0])
    finally:
        bullet.disconnect(client)
    assert in_the_mug(planned, place)


def test_a_ball_dropped_on_the_mug_ends_inside_in_mujoco(planned, out):
    mujoco = pytest.importorskip("mujoco")
    place = " ".join(map(str, above_the_mug(planned)[:3]))
    ball = f'<freejoint/><geom type="sphere" size="{BALL}" mass="0.01"/>'
    whole = (out / "mjcf" / "scene.xml").read_text()
    whole = whole.replace("</worldbody>", f'<body name="ball" pos="{place}">{ball}</body></worldbody>')
    (out / "mjcf" / "with_ball.xml").write_text(whole)
    model = mujoco.MjModel.from_xml_path(str(out / "mjcf" / "with_ball.xml"))
    data = mujoco.MjData(model)
    while data.time < SECONDS:
        mujoco.mj_step(model, data)
    assert in_the_mug(planned, data.xpos[model.body("ball").id])
    assert MUG_HEIGHT > 0.05


def test_nothing_reaches_into_the_support_and_the_foot_is_flat(planned):
    scene = planned.scene()
    for item in scene.objects:
        low = item.solid.bounds[0, 2]
        corners = np.concatenate([part.vertices for part in scene.parts[item.label].parts])
        assert corners[:, 2].min() == pytest.approx(low, abs=1e-6)
        assert scene.parts[item.label].error_m < 3e-3
    ball = trimesh.creation.icosphere(3, 0.04)
    whole = ConvexParts((ball,), ball)
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
    figures = [{"seconds": 1.0, "collision": planned.scene().collision_statement()}]
    summary = summarise(figures, motions)
    assert summary["mujoco_at_rest"] == summary["pybullet_at_rest"] == 1.0
    assert summary["error_mm_max"] < 3
