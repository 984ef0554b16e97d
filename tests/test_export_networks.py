"""Exports for grasp networks and distance fields, as numpy and Open3D load them, against the true shapes."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from planner_scene import PlannerScene, export_folder, key, planner_scene, rigid, wxyz

from perception.camera import transform
from perception.frame_io import load_frame
from reconstruction.export.formats import export
from reconstruction.solid import Solid


@pytest.fixture(scope="module")
def planned(tmp_path_factory) -> PlannerScene:
    return planner_scene(tmp_path_factory.mktemp("result"))


@pytest.fixture(scope="module")
def written(planned, tmp_path_factory):
    return export_folder(planned, tmp_path_factory.mktemp("exports"))


def test_contact_graspnet_files(written, planned):
    frame = planned.result.frame()
    with np.load(written("contact-graspnet") / "raw.npz") as raw:
        assert {"depth", "K", "segmap", "rgb"} <= set(raw.files)
        assert raw["depth"].dtype == np.float32
        assert raw["depth"] == pytest.approx(np.nan_to_num(frame.depth))
        assert (raw["segmap"] == frame.labels).all()
        assert raw["K"].shape == (3, 3)
    again = load_frame(written("contact-graspnet") / "raw.npz")
    assert again.depth.shape == frame.depth.shape
    with np.load(written("contact-graspnet") / "completed.npz") as whole:
        mine = whole["segmap"] > 0
        assert np.abs(whole["depth"] - np.nan_to_num(frame.depth))[mine & (frame.depth > 0)].max() < 1e-3
    with np.load(written("contact-graspnet") / "completed_cloud.npz") as cloud:
        world = transform(cloud["T_world_camera"], cloud["xyz"].astype(float))
        for label, mesh in planned.meshes.items():
            of_one = world[cloud["labels"] == label]
            distance = trimesh.proximity.closest_point(mesh, of_one[::20])[1]
            assert distance.max() < 1.5e-3
        hidden = cloud["hidden"] & (cloud["labels"] == 1)
        assert 0.2 < hidden.sum() / (cloud["labels"] == 1).sum() < 0.8


def test_completed_image_fills_what_was_not_measured(planned, tmp_path):
    scene = planned.scene()
    frame = planned.result.frame()
    holes = (frame.labels == 1) & (np.arange(160) % 3 == 0)
    depth = np.where(holes, np.nan, frame.depth)
    scene.frame = type(frame)(depth, frame.camera, frame.rgb, frame.labels)
    export(scene, ["contact-graspnet"], tmp_path)
    with np.load(tmp_path / "contact-graspnet" / "completed.npz") as whole:
        assert np.abs(whole["depth"] - frame.depth)[holes].max() < 1e-3
        assert (whole["segmap"][holes] == 1).all()


def test_gpd_clouds_in_open3d(written, planned):
    import open3d

    camera = planned.result.frame().camera
    for label, mesh in planned.meshes.items():
        for kind in ("target", "completed"):
            path = written("gpd") / f"{kind}_{key(label)}.pcd"
            points = np.asarray(open3d.io.read_point_cloud(str(path)).points)
            assert len(points) > 100
            assert trimesh.proximity.closest_point(mesh, points[::20])[1].max() < 1.5e-3
        low, high = points.min(0), points.max(0)
        assert low == pytest.approx(mesh.bounds[0], abs=4e-3)
        assert high == pytest.approx(mesh.bounds[1], abs=4e-3)
        head = path.read_bytes().split(b"DATA")[0].decode()
        viewpoint = [float(v) for v in head.split("VIEWPOINT ")[1].split("\n")[0].split()]
        assert rigid(viewpoint[:3], wxyz(viewpoint[3:])) == pytest.approx(camera.T_world_camera, abs=1e-6)
    line = (written("gpd") / "camera.cfg").read_text().split("=")[1]
    assert [float(v) for v in line.split()] == pytest.approx(camera.T_world_camera[:3, 3], abs=1e-5)


def test_sdf_field(written, planned):
    with np.load(written("sdf-field") / "field.npz") as field:
        distance, gradient, unknown = field["distance"], field["gradient"], field["unknown"]
        T, spacing = field["T_world_lattice"], float(field["spacing"])
    assert distance.dtype == np.float32
    assert gradient.shape == (*distance.shape, 3)
    assert unknown.shape == distance.shape
    assert unknown.dtype == bool
    rng = np.random.default_rng(0)
    nodes = rng.integers(1, np.array(distance.shape) - 1, (2000, 3))
    world = transform(T, spacing * nodes.astype(float))
    true = np.min([Solid(mesh).distance(world) for mesh in planned.meshes.values()], axis=0)
    inside = np.any([Solid(mesh).inside(world) for mesh in planned.meshes.values()], axis=0)
    found = distance[tuple(nodes.T)]
    assert np.median(np.abs(found - np.where(inside, -true, true))) < 1e-3
    assert (found < 0)[true > 1e-3].tolist() == inside[true > 1e-3].tolist()
    # Down the gradient by the distance lies the surface.
    way = gradient[tuple(nodes.T)].astype(float)
    far = np.abs(np.linalg.norm(way, axis=1) - 1) < 0.02
    there = world[far] - (found[:, None] * way)[far]
    left = np.min([Solid(mesh).distance(there) for mesh in planned.meshes.values()], axis=0)
    assert far.mean() > 0.6
    assert np.median(left) < 2e-3
    local = transform(np.linalg.inv(planned.result.T_world_table), world)
    known = unknown[tuple(nodes.T)]
    assert known[(local[:, 1] > 0.11) & (np.abs(local[:, 0]) < 0.15)].mean() > 0.9
    assert known[(local[:, 1] < 0.05) & (local[:, 1] > -0.15) & (np.abs(local[:, 0]) < 0.15)].mean() < 0.3


def test_vgn_fields(written, planned):
    for label, mesh in planned.meshes.items():
        with np.load(written("vgn") / f"{key(label)}.npz") as field:
            raw, whole = field["raw"], field["completed"]
            T, size = field["T_world_cube"], float(field["voxel_size"])
        assert raw.shape == whole.shape == (1, 40, 40, 40)
        assert raw.dtype == whole.dtype == np.float32
        assert raw.min() >= 0
        assert raw.max() <= 1
        assert (whole > 0).sum() > 1.3 * (raw > 0).sum()
        centres = (np.stack(np.meshgrid(*[np.arange(40)] * 3, indexing="ij"), -1) + 0.5) * size
        local = transform(np.linalg.inv(T), np.asarray(mesh.vertices))
        assert local.min() > 0
        assert local.max() < 0.3
        assert local[:, 2].min() == pytest.approx(0.05, abs=1e-6)
        # Signs: just inside of the mesh below 0.5, just outside above.
        world = transform(T, centres.reshape(-1, 3))
        inside = Solid(mesh).inside(world).reshape(40, 40, 40)
        near = Solid(mesh).distance(world).reshape(40, 40, 40)
        sure = (whole[0] > 0) & (near > 0.004) & (near < 0.01) & (local[:, 2].max() > centres[..., 2])
        above = sure & (centres[..., 2] > 0.062)
        if label == 2:  # the mug's wall is thinner than a voxel: views from both sides average out there
            assert (whole[0][above & inside] < 0.5).mean() > 0.95
            assert (whole[0][above & ~inside] > 0.5).mean() > 0.9
