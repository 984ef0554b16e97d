"""Every export as its consumer loads it: the same object, in the same place, in every frame and quaternion
order."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh
from planner_scene import PlannerScene, assert_same_place, export_folder, key, planner_scene, rigid, wxyz

from perception.camera import transform


@pytest.fixture(scope="module")
def planned(tmp_path_factory) -> PlannerScene:
    return planner_scene(tmp_path_factory.mktemp("result"))


@pytest.fixture(scope="module")
def written(planned, tmp_path_factory):
    return export_folder(planned, tmp_path_factory.mktemp("exports"))


def test_urdf_in_yourdfpy(written, planned):
    yourdfpy = pytest.importorskip("yourdfpy")
    robot = yourdfpy.URDF.load(str(written("urdf") / "scene.urdf"), load_collision_meshes=True)
    for label, mesh in planned.meshes.items():
        link = robot.link_map[key(label)]
        T = robot.get_transform(key(label), "world")
        visual = trimesh.load(written("urdf") / link.visuals[0].geometry.mesh.filename, process=False)
        assert_same_place(transform(T, np.asarray(visual.vertices)), mesh.vertices)
        assert len(link.collisions) >= 3
        assert link.inertial.mass == pytest.approx(500 * mesh.volume, rel=1e-3)
        solid = mesh.copy()
        solid.density = 500
        expected = np.sort(np.linalg.eigvalsh(solid.moment_inertia))
        assert np.sort(np.linalg.eigvalsh(link.inertial.inertia)) == pytest.approx(expected, rel=1e-3)


def test_urdf_in_pybullet(written, planned):
    bullet = pytest.importorskip("pybullet")
    client = bullet.connect(bullet.DIRECT)
    try:
        poses = json.loads((written("urdf") / "poses.json").read_text())
        for label, mesh in planned.meshes.items():
            pose = poses["objects"][key(label)]
            body = bullet.loadURDF(
                str(written("urdf") / f"{key(label)}.urdf"),
                pose["position"],
                pose["quaternion_xyzw"],
                flags=bullet.URDF_USE_INERTIA_FROM_FILE,
                physicsClientId=client,
            )
            # pybullet's base is the centre of mass.
            position, turn = bullet.getBasePositionAndOrientation(body, physicsClientId=client)
            assert np.abs(np.array(position) - mesh.center_mass).max() < 1e-3
            mass, _, _, at, axes = bullet.getDynamicsInfo(body, -1, physicsClientId=client)[:5]
            assert mass == pytest.approx(500 * mesh.volume, rel=1e-3)
            T = rigid(position, turn) @ np.linalg.inv(rigid(at, axes))
            visual = trimesh.load(written("urdf") / f"meshes/{key(label)}/visual.obj", process=False)
            assert_same_place(transform(T, np.asarray(visual.vertices)), mesh.vertices)
    finally:
        bullet.disconnect(client)


def test_mjcf_in_mujoco(written, planned):
    mujoco = pytest.importorskip("mujoco")
    assert 'inertia="exact"' in (written("mjcf") / "scene.xml").read_text()
    model = mujoco.MjModel.from_xml_path(str(written("mjcf") / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    up = np.array(planned.result.T_world_table)[:3, 2]
    assert model.opt.gravity == pytest.approx(-9.81 * up, abs=1e-6)
    for label, mesh in planned.meshes.items():
        body = model.body(key(label)).id
        assert model.body_mass[body] == pytest.approx(500 * mesh.volume, rel=1e-3)
        assert data.xipos[body] == pytest.approx(mesh.center_mass, abs=1e-3)
        geom = model.geom(key(label)).id
        asset = model.geom_dataid[geom]
        first, count = model.mesh_vertadr[asset], model.mesh_vertnum[asset]
        local = model.mesh_vert[first : first + count]
        found = local @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        assert_same_place(found, mesh.vertices)


def test_moveit_yaml(written, planned):
    yaml = pytest.importorskip("yaml")
    scene = yaml.safe_load((written("moveit") / "planning_scene.yaml").read_text())
    assert scene["is_diff"] is True
    for item, (label, mesh) in zip(scene["world"]["collision_objects"], planned.meshes.items(), strict=True):
        assert item["id"] == key(label)
        assert item["header"]["frame_id"] == "world"
        assert item["operation"] == 0
        place, turn = item["pose"]["position"], item["pose"]["orientation"]
        T = rigid([place[a] for a in "xyz"], [turn[a] for a in "xyzw"])
        vertices = np.array([[v[a] for a in "xyz"] for v in item["meshes"][0]["vertices"]])
        assert len(item["meshes"]) == len(item["mesh_poses"]) == 1
        assert_same_place(transform(T, vertices), mesh.vertices)


def test_moveit_bag_in_rosbags(written, planned):
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    from reconstruction.export.moveit_messages import typestore

    store = typestore()
    with rosbag2.Reader(written("moveit") / "planning_scene") as bag:
        found = {}
        for connection, _, content in bag.messages():
            found.setdefault(connection.topic, []).append(store.deserialize_cdr(content, connection.msgtype))
    assert [m.id for m in found["/collision_object"]] == ["1_mug", "2_bracket"]
    (scene,) = found["/planning_scene"]
    assert scene.is_diff
    assert [m.id for m in scene.world.collision_objects] == ["1_mug", "2_bracket"]
    poses = [scene.robot_state, scene.world.octomap.origin.orientation.w]
    assert poses[1] == 1.0  # no quaternion is all zero
    for message, mesh in zip(scene.world.collision_objects, planned.meshes.values(), strict=True):
        p, q = message.pose.position, message.pose.orientation
        (shape,), (local,) = message.meshes, message.mesh_poses
        assert (local.orientation.w, local.position.x) == (1.0, 0.0)
        vertices = np.array([[v.x, v.y, v.z] for v in shape.vertices])
        assert_same_place(transform(rigid([p.x, p.y, p.z], [q.x, q.y, q.z, q.w]), vertices), mesh.vertices)
        faces = np.array([t.vertex_indices for t in shape.triangles])
        assert (faces == mesh.faces).all()
        assert message.operation == 0
        assert message.header.frame_id == "world"


def test_moveit_bag_in_mcap(written):
    reader = pytest.importorskip("mcap.reader")
    (file,) = (written("moveit") / "planning_scene").glob("*.mcap")
    with file.open("rb") as stream:
        summary = reader.make_reader(stream).get_summary()
    assert {s.name for s in summary.schemas.values()} == {
        "moveit_msgs/msg/PlanningScene",
        "moveit_msgs/msg/CollisionObject",
    }
    assert {c.topic for c in summary.channels.values()} == {"/planning_scene", "/collision_object"}


def test_curobo_worlds(written, planned):
    yaml = pytest.importorskip("yaml")
    meshes = yaml.safe_load((written("curobo") / "world_mesh.yml").read_text())["mesh"]
    boxes = yaml.safe_load((written("curobo") / "world_cuboid.yml").read_text())["cuboid"]
    for label, mesh in planned.meshes.items():
        world = meshes[key(label)]
        T = rigid(world["pose"][:3], wxyz(world["pose"][3:]))
        assert_same_place(transform(T, np.array(world["vertices"])), mesh.vertices)
        assert (np.array(world["faces"]) == mesh.faces).all()
        box = boxes[key(label)]
        T = rigid(box["pose"][:3], wxyz(box["pose"][3:]))
        local = transform(np.linalg.inv(T), np.asarray(mesh.vertices))
        half = np.array(box["dims"]) / 2
        assert np.abs(local).max(0) == pytest.approx(half, abs=1e-4)


def test_usd_in_usd_core(written, planned):
    pxr = pytest.importorskip("pxr", reason="needs usd-core")
    from pxr import Usd, UsdGeom, UsdPhysics

    assert pxr
    stage = Usd.Stage.Open(str(written("usd") / "scene.usda"))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    for label, mesh in planned.meshes.items():
        body = stage.GetPrimAtPath(f"/World/object_{key(label)}")
        assert body.HasAPI(UsdPhysics.RigidBodyAPI)
        assert UsdPhysics.MassAPI(body).GetMassAttr().Get() == pytest.approx(500 * mesh.volume, rel=1e-3)
        visual = UsdGeom.Mesh(stage.GetPrimAtPath(f"/World/object_{key(label)}/visual"))
        T = np.array(UsdGeom.Xformable(visual).ComputeLocalToWorldTransform(Usd.TimeCode.Default())).T
        assert_same_place(transform(T, np.array(visual.GetPointsAttr().Get(), float)), mesh.vertices)
        parts = stage.GetPrimAtPath(f"/World/object_{key(label)}/collision").GetChildren()
        assert len(parts) >= 3
        for part in parts:
            assert UsdPhysics.MeshCollisionAPI(part).GetApproximationAttr().Get() == "convexHull"


def test_obj_and_glb_in_trimesh(written, planned):
    whole = trimesh.load(written("glb") / "scene.glb", process=False)
    for label, mesh in planned.meshes.items():
        plain = trimesh.load(written("obj") / f"{key(label)}.obj", process=False)
        assert_same_place(plain.vertices, mesh.vertices)
        T, name = whole.graph[key(label)]
        assert_same_place(transform(T, np.asarray(whole.geometry[name].vertices)), mesh.vertices)


def test_glb_in_open3d(written, planned):
    import open3d

    model = open3d.io.read_triangle_model(str(written("glb") / "scene.glb"))
    points = np.concatenate([np.asarray(m.mesh.vertices) for m in model.meshes])
    low, high = points.min(0), points.max(0)
    true = np.concatenate([mesh.vertices for mesh in planned.meshes.values()])
    assert low == pytest.approx(true.min(0), abs=1e-3)
    assert high == pytest.approx(true.max(0), abs=1e-3)
