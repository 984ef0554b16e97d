"""Frames that people really have (../shared/cases): the right result, or one line that says why not."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from mapping import FrameError
from perception import load_frame, load_images, observe
from perception.frame import Frame
from reconstruction import Reconstruction, reconstruct
from reconstruction.metrics import mesh_iou
from tools.cli import main

CASES = Path(__file__).parents[2] / "shared" / "cases"

pytestmark = pytest.mark.skipif(not CASES.is_dir(), reason=f"no cases at {CASES}")

K_SMALL = [302.5, 302.5, 159.5, 119.5]


def truth(case: str) -> dict[int, dict]:
    """The true objects of a case by label."""
    return {item["label"]: item for item in json.loads((CASES / case / "case.json").read_text())["truth"]}


def check_result(result: Reconstruction, case: str, labels: set[int] | None = None) -> None:
    """Every true object is there, where it stands, and about as large (upright shapes: volume and bounds)."""
    wanted = {label: item for label, item in truth(case).items() if labels is None or label in labels}
    found = {item.label: item for item in result.objects}
    assert set(found) == set(wanted)
    for label, item in wanted.items():
        mesh = found[label].mesh
        assert np.abs(mesh.bounds - np.array(item["bounds_m"])).max() < 0.015, item["name"]
        assert 0.7 < 1000 * mesh.volume / item["volume_litres"] < 1.25, item["name"]


def check_like_twin(result: Reconstruction, twin: Frame) -> None:
    """Each object is that of the frame without the fault: its IoU with any truth differs by less than 0.05,
    for 1 - IoU is a metric."""
    other = {item.label: item.mesh for item in reconstruct(twin).objects}
    for item in result.objects:
        assert mesh_iou(item.mesh, other[item.label]) > 0.95


def check_round_shapes(result: Reconstruction, case: str) -> None:
    """Cylinders and spheres of the truth are known from their bounds: IoU with them."""
    meshes = {item.label: item.mesh for item in result.objects}
    kinds = {label: item for label, item in truth(case).items() if item["kind"] in ("cyl", "sph")}
    for label in set(kinds) & set(meshes):
        low, high = np.array(kinds[label]["bounds_m"])
        radius = (high - low)[0] / 2
        round_one = (
            trimesh.creation.icosphere(4, radius)
            if kinds[label]["kind"] == "sph"
            else trimesh.creation.cylinder(radius, (high - low)[2])
        )
        round_one.apply_translation((low + high) / 2)
        assert mesh_iou(meshes[label], round_one) > 0.8


def refusal(frame: Frame) -> str:
    """The one line with which a frame is refused before any of its space is worked on."""
    with pytest.raises(FrameError) as caught:
        observe(frame)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_01_the_top_of_the_range_is_no_depth() -> None:
    frame, twin = (
        load_frame(CASES / "01-depth-65535-no-return" / name) for name in ("frame", "frame_with_0")
    )
    np.testing.assert_array_equal(frame.depth, twin.depth)
    assert "65535" in frame.notes[0]
    np.testing.assert_array_equal(observe(frame).depth, observe(twin).depth)


def test_02_another_unit_is_refused_and_the_right_one_offered() -> None:
    folder = CASES / "02-depth-in-another-unit"
    wrong = load_images(None, folder / "depth_0_to_10m.png", folder / "labels.png", K_SMALL, None)
    line = refusal(wrong)
    assert "depth_scale times 0.1526" in line
    right = load_images(None, folder / "depth_0_to_10m.png", folder / "labels.png", K_SMALL, 0.001 * 0.1526)
    sizes = {item.label: float(np.ptp(item.points[:, 2])) for item in observe(right).objects}
    assert sizes[1] == pytest.approx(0.16, abs=0.005)


def test_02_the_mend_of_the_message_mends(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = CASES / "02-depth-in-another-unit"
    options = ["map", "--depth", str(folder / "depth_mm.npy"), "--labels", str(folder / "labels_small.png")]
    options += ["--intrinsics", "151.25", "151.25", "79.5", "59.5", "--out", str(tmp_path / "out")]
    assert main(options) == 2
    assert "0.001 for millimetres" in capsys.readouterr().err
    assert main([*options, "--depth-scale", "0.001"]) == 0
    sizes = {
        item["label"]: item["extents"]
        for item in json.loads((tmp_path / "out/scene.json").read_text())["objects"]
    }
    assert sizes[1][2] == pytest.approx(0.16, abs=0.01)


def test_03_a_label_on_the_table_is_the_support() -> None:
    frame = load_frame(CASES / "03-table-has-label-1" / "frame")
    result = reconstruct(frame)
    check_result(result, "03-table-has-label-1")
    check_round_shapes(result, "03-table-has-label-1")
    (skipped,) = result.skipped
    assert skipped.label == 1
    assert "support plane" in skipped.reason
    assert frame.labels is not None
    twin = Frame(frame.depth, frame.camera, labels=np.where(frame.labels == 1, 0, frame.labels))
    assert [item.pixels.size for item in observe(twin).objects] == [
        item.pixels.size for item in result.observation.objects
    ]
    check_like_twin(result, twin)


def test_05_masks_in_files_of_their_own() -> None:
    frame = load_frame(CASES / "05-masks-in-files-of-their-own" / "frame")
    assert "masks" in frame.notes[0]
    result = reconstruct(frame)
    check_result(result, "05-masks-in-files-of-their-own")
    check_round_shapes(result, "05-masks-in-files-of-their-own")
    masks = CASES / "05-masks-in-files-of-their-own" / "frame" / "masks"
    from perception.inputs.label_files import read_labels

    np.testing.assert_array_equal(read_labels(masks).image, frame.labels)


def test_06_the_matrix_of_another_resolution_is_refused() -> None:
    with pytest.raises(FrameError, match=r"K belongs to a 320x240 image"):
        load_frame(CASES / "06-K-of-another-resolution" / "frame")


def test_12_what_is_far_behind_is_skipped() -> None:
    frame = load_frame(CASES / "12-labelled-things-far-behind" / "frame")
    result = reconstruct(frame)
    assert frame.labels is not None
    twin = np.where(np.isin(frame.labels, (3, 4)), 0, frame.labels)
    check_like_twin(result, Frame(frame.depth, frame.camera, labels=twin))
    check_round_shapes(result, "12-labelled-things-far-behind")
    check_result(result, "12-labelled-things-far-behind", {1, 2})
    reasons = {item.label: item.reason for item in result.skipped}
    assert set(reasons) == {3, 4}
    assert all("far" in reason or "large" in reason for reason in reasons.values())
