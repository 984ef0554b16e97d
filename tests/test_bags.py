"""Frames from ROS 1 and ROS 2 bags: the same meshes as the frame folders, errors that say what is missing."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from bags import COLOUR, DEPTH, IMAGE, INFO, KINDS, OPTICAL, START, image, write_bag
from conftest import make_tabletop

pytest.importorskip("rosbags")

from mapping.errors import FrameError
from perception.datasets.bags.bag import Bag, load_bag, shots_of_bag
from perception.datasets.bags.config import BagConfig
from perception.datasets.bags.transforms import Edge
from perception.frame import Frame
from perception.frame_io import load_frame, save_frame
from reconstruction import load_result, reconstruct
from reconstruction.files import result_folder
from reconstruction.files.stored import StoredResult
from reconstruction.result import Reconstruction
from tools.cli import main

EYES = ((-0.55, 0.0, 0.5), (0.6, 0.1, 0.5))


@cache
def frames() -> list[Frame]:
    return [
        make_tabletop(eye=eye, size=(96, 72), noise=0.001, seed=seed).frame for seed, eye in enumerate(EYES)
    ]


@pytest.mark.parametrize("kind", KINDS)
def test_frames_are_those_that_were_recorded(tmp_path: Path, kind: str) -> None:
    path = write_bag(tmp_path / "run", frames(), kind, label="32SC1" if kind == "mcap" else "mono16")
    for number, frame in enumerate(frames()):
        save_frame(frame, tmp_path / "folder")
        wanted, found = load_frame(tmp_path / "folder"), load_bag(path, at=number + 0.1)
        np.testing.assert_allclose(found.depth, wanted.depth, atol=1e-7)
        np.testing.assert_array_equal(found.labels, wanted.labels)
        np.testing.assert_array_equal(found.rgb, wanted.rgb)
        np.testing.assert_allclose(found.camera.K, wanted.camera.K, atol=1e-12)
        np.testing.assert_allclose(found.camera.T_world_camera, wanted.camera.T_world_camera, atol=1e-9)
    shots = shots_of_bag(path)
    assert [shot.name for shot in shots] == ["0.000 s", "1.000 s"]
    assert shots[1].stamp == pytest.approx(START / 1e9 + 1)
    assert len(shots_of_bag(path, BagConfig(every=1.5))) == 1
    absolute = load_bag(path, at=START / 1e9 + 1)
    np.testing.assert_allclose(absolute.depth, found.depth)


def test_a_bag_maps_as_its_frames_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(result_folder, "draw_overview", lambda r, path, truth: path.write_bytes(b"none"))
    path = write_bag(tmp_path / "run", frames()[:1], "ros1", depth="32FC1")
    save_frame(frames()[0].renamed({}), tmp_path / "folder")
    (tmp_path / "folder" / "names.json").unlink()
    assert main(["map", str(path), "--at", "0", "--out", str(tmp_path / "a")]) == 0
    assert same_meshes(load_result(tmp_path / "a"), reconstruct(load_frame(tmp_path / "folder"))) == 4


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_streams_as_its_frames_do(tmp_path: Path, kind: str) -> None:
    path = write_bag(tmp_path / "run", frames(), kind)
    for number, frame in enumerate(frames()):
        save_frame(frame, tmp_path / "folder" / str(number))
        (tmp_path / "folder" / str(number) / "names.json").unlink()
    assert main(["stream", str(path), "--out", str(tmp_path / "a")]) == 0
    assert main(["stream", str(tmp_path / "folder"), "--out", str(tmp_path / "b")]) == 0
    assert same_meshes(load_result(tmp_path / "a"), load_result(tmp_path / "b")) == 4
    assert load_result(tmp_path / "a").scene["stream"]["frames"][1]["stamp"] == pytest.approx(START / 1e9 + 1)


def same_meshes(ours: StoredResult, theirs: StoredResult | Reconstruction) -> int:
    """How many meshes two results have that are the same to 1 micrometre."""
    for item in ours:
        other = theirs[item.label]
        np.testing.assert_array_equal(item.mesh.faces, other.mesh.faces)
        np.testing.assert_allclose(item.mesh.vertices, other.mesh.vertices, atol=1e-6)
        np.testing.assert_allclose(item.uncertainty, other.uncertainty, atol=1e-4)
    return len(ours.objects)


@pytest.mark.parametrize(
    ("leave_out", "said"),
    [
        ((DEPTH,), "no depth topic"),
        (("/tf",), "no tf"),
        ((INFO,), "no CameraInfo"),
    ],
)
def test_what_is_missing_is_said(
    tmp_path: Path, leave_out: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_bag(tmp_path / "run", frames()[:1], leave_out=leave_out)
    assert main(["map", str(path), "--out", str(tmp_path / "out")]) == 2
    message = capsys.readouterr().err
    assert said in message
    assert message.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_time_that_is_not_covered_is_said(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "run", frames())
    with pytest.raises(FrameError, match=r"no depth image within 0.5 s of 7 s.*0 to 1.000 s"):
        load_bag(path, at=7.0)


def test_a_pose_that_tf_does_not_cover_is_said(tmp_path: Path) -> None:
    late = START + 5 * 10**9
    depth = (np.nan_to_num(frames()[0].depth) * 1000).astype(np.uint16)
    labels = frames()[0].labels
    assert labels is not None
    further = [(DEPTH, IMAGE, late, image(depth, "16UC1", late))]
    further.append(("/segmentation/labels", IMAGE, late, image(labels, "mono16", late)))
    path = write_bag(tmp_path / "run", frames()[:1], further=further)
    with pytest.raises(FrameError, match="tf says where hand is from"):
        load_bag(path, at=5.0)
    shots = shots_of_bag(path)
    assert shots[0].load().labels is not None  # the others are there
    with pytest.raises(FrameError, match=r"5\.000 s: tf says"):
        shots[1].load()


@pytest.mark.parametrize("kind", KINDS)
def test_a_cut_bag_is_said(tmp_path: Path, kind: str) -> None:
    path = write_bag(tmp_path / "run", frames()[:1], kind)
    file = path if kind == "ros1" else next(p for p in path.iterdir() if p.suffix in (".mcap", ".db3"))
    whole = file.read_bytes()
    for share in (0.0, 0.5, 0.95):
        file.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(FrameError, match="not a readable bag"):
            load_bag(path)


def test_topics_that_could_be_either_are_named(tmp_path: Path) -> None:
    depth = (np.nan_to_num(frames()[0].depth) * 1000).astype(np.uint16)
    second = [("/other/depth", IMAGE, START, image(depth, "16UC1", START))]
    path = write_bag(tmp_path / "run", frames()[:1], further=second)
    with pytest.raises(
        FrameError, match=r"several topics could be depth: .*aligned.*; /other/depth"
    ) as error:
        load_bag(path)
    assert "--bag.depth" in str(error.value)
    assert load_bag(path, config=BagConfig(depth="/other/depth")).labels is not None
    with pytest.raises(FrameError, match=r"no depth topic '/nothing'"):
        load_bag(path, config=BagConfig(depth="/nothing"))


def test_depth_of_the_sensor_gives_way_to_depth_aligned_to_colour(tmp_path: Path) -> None:
    depth = np.full((72, 96), 1000, np.uint16)
    raw = [("/camera/depth/image_rect_raw", IMAGE, START, image(depth, "16UC1", START, "camera_depth_frame"))]
    bag = Bag.open(write_bag(tmp_path / "run", frames()[:1], further=raw))
    assert bag.topics.depth.name == DEPTH
    assert bag.topics.colour is not None
    assert bag.topics.colour.name == COLOUR


def test_without_labels_depth_is_segmented_and_without_tf_a_still_camera_can_be_said(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "run", frames()[:1], leave_out=("/segmentation/labels", "/tf"))
    frame = load_bag(path, config=BagConfig(fixed_frame=OPTICAL))
    assert frame.labels is None
    np.testing.assert_array_equal(frame.camera.T_world_camera, np.eye(4))


def test_poses_are_interpolated() -> None:
    edge = Edge(
        "map", False, [0, 10**9], [(0, 0, 0, 0, 0, 0, 1), (1, 2, 0, 0, 0, np.sqrt(0.5), np.sqrt(0.5))]
    )
    T = edge.at(5 * 10**8, "hand")
    np.testing.assert_allclose(T[:3, 3], [0.5, 1.0, 0.0])
    np.testing.assert_allclose(T[:2, :2], np.sqrt(0.5) * np.array([[1, -1], [1, 1]]), atol=1e-12)
    with pytest.raises(FrameError, match="not at 3"):
        edge.at(3 * 10**9, "hand")
    edge.stamps[1] = 2 * 10**9
    with pytest.raises(FrameError, match="says nothing of where hand is for 2"):
        edge.at(10**9, "hand")
