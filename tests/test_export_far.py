"""Exports of an object far from the world's origin: every mesh file is closed, and right in its own frame."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from mapping.errors import DataError
from perception.camera import transform
from reconstruction.export.export_scene import ExportScene
from reconstruction.export.formats import export
from reconstruction.files.mesh_files import encode_obj, encode_ply
from reconstruction.files.result_folder import StoredObject, StoredResult

FAR = np.array([3_000_000.0, -2_000_000.0, 1_700_000.0])
"""4,000 km from the origin [m]."""
RIGHT = 1e-5
"""A hundredth of a millimetre [m]."""
KEY = "1_ball"

Found = tuple[trimesh.Trimesh, np.ndarray]
"""A mesh as a consumer reads it, and where its frame stands: T_world_mesh (4, 4)."""


def far_scene(subdivisions: int, folder: Path) -> ExportScene:
    """One ball of 10 cm, a tenth of it drawn out along x, so that no turn goes unseen."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.1)
    T = trimesh.transformations.euler_matrix(0.3, -0.5, 1.1)
    T[:3, 3] = FAR
    local = ball.vertices * [1.1, 1.0, 1.0]
    mesh = trimesh.Trimesh(transform(T, local), ball.faces, process=False)
    unsure = np.zeros(len(local), np.float32)
    item = StoredObject(1, "ball", mesh, unsure, T, np.array([0.22, 0.2, 0.2]), folder, 1)
    scene = {"T_world_table": T.tolist(), "support_plane": {"inlier_ratio": 1.0}}
    return ExportScene(StoredResult(folder, scene, (item,)))


def from_yaml(path: Path) -> dict:
    """These files are JSON lines within YAML, which yaml itself reads a hundred times more slowly."""
    (line,) = [line for line in path.read_text().splitlines() if line.startswith(f'  "{KEY}"')]
    return json.loads(line.split(": ", 1)[1])


def in_plain_obj(out: Path, scene: ExportScene) -> Found:
    return trimesh.load(out / "obj" / f"{KEY}.obj", process=False), np.eye(4)


def in_glb(out: Path, scene: ExportScene) -> Found:
    whole = trimesh.load(out / "glb" / "scene.glb", process=False)
    T, name = whole.graph[KEY]
    return whole.geometry[name], T


def in_urdf(out: Path, scene: ExportScene) -> Found:
    poses = json.loads((out / "urdf" / "poses.json").read_text())["objects"][KEY]
    T = trimesh.transformations.quaternion_matrix(np.roll(poses["quaternion_xyzw"], 1))
    T[:3, 3] = poses["position"]
    return trimesh.load(out / "urdf" / "meshes" / KEY / "visual.obj", process=False), T


def in_mjcf(out: Path, scene: ExportScene) -> Found:
    import xml.etree.ElementTree as xml

    body = xml.parse(out / "mjcf" / "scene.xml").find(f".//body[@name='{KEY}']")
    assert body is not None
    T = trimesh.transformations.quaternion_matrix([float(v) for v in body.get("quat", "").split()])
    T[:3, 3] = [float(v) for v in body.get("pos", "").split()]
    (file,) = (out / "mjcf").rglob(f"{KEY}.obj")
    return trimesh.load(file, process=False), T


def in_usd(out: Path, scene: ExportScene) -> Found:
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(out / "usd" / "scene.usda"))
    visual = UsdGeom.Mesh(stage.GetPrimAtPath(f"/World/object_{KEY}/visual"))
    T = np.array(UsdGeom.Xformable(visual).ComputeLocalToWorldTransform(Usd.TimeCode.Default())).T
    faces = np.array(visual.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    return trimesh.Trimesh(np.array(visual.GetPointsAttr().Get(), float), faces, process=False), T


def in_curobo(out: Path, scene: ExportScene) -> Found:
    held = from_yaml(out / "curobo" / "world_mesh.yml")
    T = trimesh.transformations.quaternion_matrix(held["pose"][3:])
    T[:3, 3] = held["pose"][:3]
    return trimesh.Trimesh(held["vertices"], held["faces"], process=False), T


def in_moveit(out: Path, scene: ExportScene) -> Found:
    from rosbags import rosbag2

    from reconstruction.export.moveit_messages import typestore

    store = typestore()
    with rosbag2.Reader(out / "moveit" / "planning_scene") as bag:
        (message,) = [
            store.deserialize_cdr(content, connection.msgtype)
            for connection, _, content in bag.messages()
            if connection.topic == "/collision_object"
        ]
    p, q = message.pose.position, message.pose.orientation
    T = trimesh.transformations.quaternion_matrix([q.w, q.x, q.y, q.z])
    T[:3, 3] = [p.x, p.y, p.z]
    vertices = np.array([[v.x, v.y, v.z] for v in message.meshes[0].vertices])
    faces = np.array([t.vertex_indices for t in message.meshes[0].triangles])
    return trimesh.Trimesh(vertices, faces, process=False), T


FORMATS: dict[str, tuple[Callable[[Path, ExportScene], Found], str]] = {
    "obj": (in_plain_obj, "trimesh"),
    "glb": (in_glb, "trimesh"),
    "urdf": (in_urdf, "manifold3d"),
    "mjcf": (in_mjcf, "manifold3d"),
    "usd": (in_usd, "pxr"),
    "curobo": (in_curobo, "trimesh"),
    "moveit": (in_moveit, "rosbags"),
}


@pytest.fixture(
    scope="module", params=[3, pytest.param(7, marks=pytest.mark.slow)], ids=["642", "163842_vertices"]
)
def far(request, tmp_path_factory) -> ExportScene:
    return far_scene(request.param, tmp_path_factory.mktemp("result"))


@pytest.mark.parametrize("name", FORMATS)
def test_every_export_is_closed_and_right(far: ExportScene, tmp_path: Path, name: str) -> None:
    read, package = FORMATS[name]
    pytest.importorskip(package)
    export(far, [name], tmp_path)
    found, T = read(tmp_path, far)
    (item,) = far.objects
    assert len(found.vertices) == len(item.mesh.vertices)
    assert found.is_volume
    # In the frame of the object: what is taken from it is where it stands, not how far away that is.
    T_object_mesh = np.eye(4)
    turn = item.T_world_object[:3, :3].T
    T_object_mesh[:3, :3] = turn @ T[:3, :3]
    T_object_mesh[:3, 3] = turn @ (T[:3, 3] - item.T_world_object[:3, 3])
    local = transform(T_object_mesh, np.asarray(found.vertices))
    assert np.abs(local - item.mesh.vertices).max() < RIGHT


def test_the_results_own_files_are_closed_and_right(far: ExportScene, tmp_path: Path) -> None:
    (item,) = far.result.objects
    for name, content in (
        ("mesh.ply", encode_ply(item.mesh, item.uncertainty)),
        ("mesh.obj", encode_obj(item.mesh)),
    ):
        (tmp_path / name).write_bytes(content)
        assert trimesh.load(tmp_path / name).is_volume
        found = trimesh.load(tmp_path / name, process=False)
        assert np.abs((found.vertices - FAR) - (item.mesh.vertices - FAR)).max() < RIGHT


def test_what_holds_single_precision_only_is_refused(far: ExportScene, tmp_path: Path) -> None:
    """GPD's point clouds: 4,000 km away a point would be a quarter of a metre off."""
    with pytest.raises(DataError, match="single precision"):
        export(far, ["gpd"], tmp_path)
    assert not list(tmp_path.iterdir())
