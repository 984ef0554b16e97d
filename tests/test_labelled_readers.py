"""Labelled clouds: SemanticKITTI folders, .npz, .ply, .las, .laz, meshes, and files that are broken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mapping.errors import DataError
from perception.datasets.labelled_clouds import read_cloud
from perception.datasets.labelled_meshes import LabelledMesh, read_mesh, sample_by_area, seen_from, viewpoints
from perception.datasets.semantickitti import CLASSES, KittiSequence, read_scan
from perception.labelled_cloud import UNLABELLED, free_points

KITTI = Path(__file__).parents[1] / ".." / "shared" / "data" / "semantickitti" / "sequences"
POINTS = np.array([[1.0, 2, 3], [4, 5, 6], [7, 8, 9], [1, 1, 1]])


def sequence(folder: Path, raw=(10, 252, 0, 40), scans: int = 2) -> Path:
    """A sequence whose camera looks along the scanner's x and moves 2 m forward a scan."""
    for part in ("velodyne", "labels"):
        (folder / part).mkdir(parents=True)
    for scan in range(scans):
        values = np.column_stack([POINTS, np.zeros(4)]).astype(np.float32)
        (folder / "velodyne" / f"{scan:06d}.bin").write_bytes(values.tobytes())
        ids = np.array(raw, np.uint32) | (7 << 16)
        (folder / "labels" / f"{scan:06d}.label").write_bytes(ids.tobytes())
    (folder / "calib.txt").write_text("P0: 1 2\nTr: 0 -1 0 0 0 0 -1 0 1 0 0 0\n")
    poses = [f"1 0 0 0 0 1 0 0 0 0 1 {2 * scan}" for scan in range(scans)]
    (folder / "poses.txt").write_text("\n".join(poses))
    return folder


def test_kitti_labels_are_folded_and_poses_move_the_scanner(tmp_path):
    sequence_ = KittiSequence(sequence(tmp_path / "00"))
    assert sequence_.scans() == ["000000", "000001"]
    cloud = sequence_.scan("000000")
    assert [CLASSES[k] for k in cloud.labels[[0, 1, 3]]] == ["car", "car", "road"]
    assert cloud.labels[2] == UNLABELLED
    assert len(cloud.labelled().points) == 3
    moved = sequence_.scan("000001", sequence_.poses()[1])
    # Forward is the scanner's x.
    np.testing.assert_allclose(moved.points, POINTS + np.array([2, 0, 0]), atol=1e-6)
    np.testing.assert_allclose(moved.origin, [2, 0, 0], atol=1e-6)


def test_kitti_files_that_are_broken_are_one_clear_error(tmp_path):
    folder = sequence(tmp_path / "00")
    velodyne, label = folder / "velodyne" / "000000.bin", folder / "labels" / "000000.label"
    whole = velodyne.read_bytes()
    velodyne.write_bytes(whole[:-5])
    with pytest.raises(DataError, match="truncated"):
        read_scan(velodyne, label)
    velodyne.write_bytes(whole[:-16])
    with pytest.raises(DataError, match="4 labels for the 3 points"):
        read_scan(velodyne, label)
    velodyne.write_bytes(b"")
    with pytest.raises(DataError, match="empty"):
        read_scan(velodyne, label)
    (folder / "poses.txt").unlink()
    with pytest.raises(DataError, match="no poses"):
        KittiSequence(folder).poses()
    (folder / "poses.txt").write_text("1 2 3")
    with pytest.raises(DataError, match="twelve numbers"):
        KittiSequence(folder).poses()
    (folder / "calib.txt").unlink()
    (folder / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0")
    with pytest.raises(DataError, match=r"calib\.txt"):
        KittiSequence(folder).poses()


def test_unknown_ids_and_points_that_are_not_finite_are_counted(tmp_path):
    folder = sequence(tmp_path / "00", raw=(10, 40, 7777, 40), scans=1)
    values = np.column_stack([POINTS, np.zeros(4)]).astype(np.float32)
    values[1, 2] = np.nan
    (folder / "velodyne" / "000000.bin").write_bytes(values.tobytes())
    cloud = KittiSequence(folder).scan("000000")
    assert cloud.skipped == {"labels of unknown id": 1, "points that are not finite": 1}
    assert len(cloud.points) == 3


def test_clouds_of_every_format_say_the_same(tmp_path):
    import laspy
    import open3d

    labels = np.array([5, 2, 2, 9])
    np.savez(tmp_path / "a.npz", points=POINTS, labels=labels)
    las = laspy.create(point_format=6)
    las.header.scales = [0.001] * 3
    las.xyz, las.classification = POINTS, labels
    for name in ("a.las", "a.laz"):
        las.write(tmp_path / name)
    ply = open3d.t.geometry.PointCloud(open3d.core.Tensor(POINTS.astype(np.float32)))
    ply.point["label"] = open3d.core.Tensor(labels.astype(np.int32)[:, None])
    open3d.t.io.write_point_cloud(str(tmp_path / "a.ply"), ply)
    for name in ("a.npz", "a.las", "a.laz", "a.ply"):
        cloud = read_cloud(tmp_path / name)
        np.testing.assert_allclose(cloud.points, POINTS, atol=1e-3)
        assert [cloud.names[k] for k in cloud.labels] == ["5", "2", "2", "9"]


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"points": POINTS}, "no array 'labels'"),
        ({"points": POINTS, "labels": np.arange(3)}, "labels of shape"),
        ({"points": POINTS, "labels": np.full(4, 0.5)}, "whole number"),
        ({"points": POINTS * np.nan, "labels": np.arange(4)}, "no finite point"),
        ({"points": POINTS[:0], "labels": np.arange(0)}, "no finite point"),
        ({"points": POINTS, "labels": np.arange(4), "names": np.array(["a"])}, "1 classes"),
        ({"points": POINTS, "labels": np.arange(4), "origin": np.zeros(2)}, "origin"),
    ],
)
def test_bad_clouds_are_one_clear_error(tmp_path, arrays, message):
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(DataError, match=message):
        read_cloud(tmp_path / "a.npz")


def test_other_files_are_refused(tmp_path):
    (tmp_path / "a.las").write_bytes(b"no")
    (tmp_path / "a.txt").write_text("1 2 3")
    for name, message in {"a.las": "not a readable", "a.txt": "cannot read", "b.npz": "no such"}.items():
        with pytest.raises(DataError, match=message):
            read_cloud(tmp_path / name)


def cube() -> LabelledMesh:
    """A cube of 4 m seen from within: walls in the planes of x are class 0, all others 1."""
    import trimesh

    box = trimesh.creation.box((4, 4, 4))
    wall = np.abs(box.face_normals[:, 0]) < 0.5
    return LabelledMesh("cube", box.vertices, box.faces, wall.astype(np.int64), ("x", "other"))


def test_meshes_are_sampled_by_area_and_seen_by_cameras():
    rng = np.random.default_rng(0)
    even = sample_by_area(cube(), 6000, rng)
    assert (even.labels == 0).mean() == pytest.approx(1 / 3, abs=0.03)
    places = viewpoints(cube(), 3, rng)
    assert np.abs(places).max() < 1.6 + 1e-6
    for cloud in (even, seen_from(cube(), places[0], 500, rng)):
        np.testing.assert_allclose(np.abs(cloud.points).max(axis=1), 2.0, atol=1e-4)
        on_x = np.abs(cloud.points[:, 0]) > 2 - 1e-4
        assert (cloud.labels[on_x] == 0).mean() > 0.99
        assert (cloud.labels[~on_x] == 1).all()
    free = free_points(seen_from(cube(), places[0], 500, rng), 0.5, 0.1, rng)
    assert np.abs(free).max() < 2.0
    with pytest.raises(DataError, match="sensor's position"):
        free_points(even, 0.5, 0.1, rng)


def test_meshes_are_read_and_checked(tmp_path):
    mesh = cube()
    good = {
        "vertices": mesh.vertices,
        "faces": mesh.faces,
        "face_object": np.zeros(12, int),
        "object_class": np.array(["wall"]),
    }
    np.savez(tmp_path / "m.npz", **good)
    assert read_mesh(tmp_path / "m.npz").names == ("wall",)
    np.savez(tmp_path / "m.npz", **{**good, "face_object": np.ones(12, int)})
    with pytest.raises(DataError, match="not there"):
        read_mesh(tmp_path / "m.npz")


@pytest.mark.skipif(not KITTI.is_dir(), reason="../shared/data/semantickitti is absent: no real scans")
def test_a_real_scan_is_read():
    sequence_ = KittiSequence(KITTI / "00")
    cloud = sequence_.scan("000000")
    assert len(cloud.points) == 124668
    assert not cloud.skipped
    poses = sequence_.poses()
    step = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    assert (step > 0.3).all()
    assert (poses[1:, 0, 3] > 0.3).all()  # forward is the scanner's x
