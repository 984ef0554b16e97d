"""Recordings are read back: every entity is there with the run's numbers, and rerun accepts the file."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest
from solids import KEYS, reconstructed_tabletop, true_meshes

from mapping.errors import DataError
from perception.camera import invert_rigid, transform
from reconstruction.files.output_folder import RECORDING, check_output
from reconstruction.files.recordings import name_recording
from reconstruction.files.result_folder import save_reconstruction
from reconstruction.pictures.recording import record
from tools.view import find_recording, view

pytest.importorskip("rerun", reason="recordings need the viz extra")


@pytest.fixture(scope="module")
def reconstruction():
    return reconstructed_tabletop()


@pytest.fixture(scope="module")
def stored(reconstruction, tmp_path_factory):
    return save_reconstruction(reconstruction, tmp_path_factory.mktemp("stored") / "result")


@pytest.fixture
def result(stored, tmp_path):
    """A result folder without a recording, to be changed."""
    return Path(copytree(stored, tmp_path / "result"))


@pytest.fixture(scope="module")
def recording(reconstruction, tmp_path_factory):
    path = tmp_path_factory.mktemp("recording") / "run.rrd"
    record(reconstruction, path, true_meshes())
    return path


@pytest.fixture(scope="module")
def chunks(recording):
    from rerun.chunk import RrdReader

    return list(RrdReader(recording).stream())


def column(chunks, entity, component):
    """The first row of one component as numpy, read from the file."""
    for chunk in chunks:
        batch = chunk.to_record_batch()
        if chunk.entity_path == entity and component in batch.schema.names:
            return batch.column(component)[0].values.to_numpy(zero_copy_only=False)
    raise AssertionError(f"{entity} has no {component}")


def test_every_documented_entity_is_there(chunks, reconstruction):
    found = {chunk.entity_path for chunk in chunks}
    wanted = {
        "/world",
        "/world/camera",
        "/world/cloud/objects",
        "/world/cloud/background",
        "/world/table",
        "/world/table/hinges",
        "/world/slice",
        "/fit/loss",
        "/world/axes",
        "/world/table/axes",
        "/legend/uncertainty",
        "/summary",
    }
    stages = [stage for stage in reconstruction.timings_ms if stage != "total"]
    wanted |= {f"/timings/{place}_{stage}" for place, stage in enumerate(stages, 1)}
    wanted |= {f"/world/camera/{image}" for image in ("rgb", "depth", "labels")}
    wanted |= {f"/world/table/samples/{name}" for name in ("empty", "uncertain", *KEYS)}
    wanted |= {f"/world/{group}/{key}" for group in ("meshes", "uncertainty", "boxes") for key in KEYS}
    wanted |= {f"/world/truth/{label}" for label in true_meshes()}
    assert wanted <= found


def test_losses_lie_on_their_own_timeline(chunks, reconstruction):
    chunk = next(c for c in chunks if c.entity_path == "/fit/loss" and "step" in c.timeline_names)
    batch = chunk.to_record_batch()
    losses = [row.as_py()[0] for row in batch.column("Scalars:scalars")]
    np.testing.assert_allclose(losses, reconstruction.map.report.losses)
    assert batch.column("step").to_pylist() == list(range(len(losses)))


def test_meshes_and_hinges_are_the_results(chunks, reconstruction):
    item = reconstruction.objects[0]
    stored = column(chunks, f"/world/meshes/{item.label}_{item.name}", "Mesh3D:vertex_positions")
    np.testing.assert_allclose(np.stack(list(stored)), item.mesh.vertices, atol=1e-6)
    hinges = column(chunks, "/world/table/hinges", "Points3D:positions")
    np.testing.assert_allclose(np.stack(list(hinges)), reconstruction.map.hinges, atol=1e-6)


def test_boxes_have_names_and_stand_upright_around_their_meshes(chunks, reconstruction):
    up = reconstruction.T_world_table[:3, 2]
    for item in reconstruction.objects:
        entity = f"/world/boxes/{item.label}_{item.name}"
        assert list(column(chunks, entity, "Boxes3D:labels")) == [item.name]
        half = np.stack(list(column(chunks, entity, "Boxes3D:half_sizes")))[0]
        shift = np.stack(list(column(chunks, entity, "Transform3D:translation")))[0]
        axes = np.stack(list(column(chunks, entity, "Transform3D:mat3x3")))[0].reshape(3, 3).T
        np.testing.assert_allclose(axes[:, 2], up, atol=1e-6)
        local = (item.mesh.vertices - shift) @ axes
        np.testing.assert_allclose(np.abs(local).max(0), half, atol=1e-5)


def test_the_first_view_is_from_the_side_and_above(recording, reconstruction):
    from rerun.chunk import RrdReader

    reader = RrdReader(recording)
    views = list(reader.stream(store=reader.blueprints()[0]))
    chunk = next(c for c in views if "EyeControls3D:position" in c.to_record_batch().schema.names)
    eye = chunk.to_record_batch().column("EyeControls3D:position")[0].values.to_numpy(zero_copy_only=False)
    eye = np.stack(list(eye))[0]
    own = transform(
        invert_rigid(reconstruction.T_world_table), reconstruction.frame.camera.T_world_camera[None, :3, 3]
    )[0]
    turned = np.degrees(np.arctan2(eye[1], eye[0]) - np.arctan2(own[1], own[0]))
    assert 45 < abs((turned + 180) % 360 - 180) < 90
    assert eye[2] > 0.05


def test_every_sample_is_logged_once(chunks, reconstruction):
    entities = {c.entity_path for c in chunks if c.entity_path.startswith("/world/table/samples/")}
    counts = [len(column(chunks, entity, "Points3D:positions")) for entity in entities]
    assert sum(counts) == len(reconstruction.samples)


def test_a_blueprint_is_stored_in_the_same_file(recording):
    from rerun.chunk import RrdReader

    reader = RrdReader(recording)
    assert len(reader.recordings()) == 1
    assert len(reader.blueprints()) == 1
    views = list(reader.stream(store=reader.blueprints()[0]))
    assert sum(chunk.entity_path.startswith("/view/") for chunk in views) >= 8


def test_rerun_verifies_the_file(recording):
    done = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "verify", str(recording)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def test_a_folder_that_does_not_exist_is_one_clear_error(reconstruction, tmp_path):
    with pytest.raises(DataError, match="does its folder exist"):
        record(reconstruction, tmp_path / "nowhere" / "run.rrd")


def test_view_without_display_says_what_to_type(result, recording, monkeypatch, capsys):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    (result / RECORDING).write_bytes(recording.read_bytes())
    view(result)
    told = capsys.readouterr().out
    assert str(result / RECORDING) in told
    assert "rerun recording.rrd" in told


def test_view_builds_a_recording_from_meshes_when_there_is_none(result):
    from rerun.chunk import RrdReader

    assert not (result / RECORDING).exists()
    recording = find_recording(result)
    found = {chunk.entity_path for chunk in RrdReader(recording).stream()}
    assert {f"/world/{kind}/{KEYS[0]}" for kind in ("uncertainty", "meshes", "boxes")} <= found
    assert {"/world/axes", "/legend/uncertainty", "/timings/1_observe", "/summary"} <= found


def test_view_finds_the_recording_of_the_run_wherever_it_lies(result, tmp_path):
    run = tmp_path / "run.rrd"
    run.write_bytes(b"RRF2 of this run")
    name_recording(result, run)
    assert find_recording(result).samefile(run)
    moved = tmp_path / "moved"
    moved.mkdir()
    for path in (result, run):
        path.rename(moved / path.name)
    assert find_recording(moved / "result").samefile(moved / "run.rrd")
    (moved / "run.rrd").write_bytes(b"RRF2 of another run")
    assert find_recording(moved / "result") == moved / "result" / RECORDING


def test_a_recording_in_the_result_folder_is_the_results_own(result):
    (result / "run.rrd").write_bytes(b"RRF2")
    name_recording(result, result / "run.rrd")
    assert check_output(result, overwrite=True).samefile(result)  # ConfigError where foreign files lie


def test_view_of_something_else_is_a_clear_error(tmp_path):
    with pytest.raises(DataError, match="not a result folder"):
        view(tmp_path)
