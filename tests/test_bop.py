"""BOP's layout: what our own simulator writes is read back, mapped from the command line, and evaluated."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from benchmark_scenes import write_scenes

from mapping import FrameError
from mapping.errors import DataError
from perception import load_frame
from perception.datasets.bop import bop_images, bop_objects, load_bop
from sim_scenes.bop_folder import write_bop
from sim_scenes.truth import load_truth
from tools.cli import main


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two simulated scenes of two solids each."""
    folder = write_scenes(tmp_path_factory.mktemp("scenes"))
    return sorted(path for path in folder.iterdir() if path.is_dir())


@pytest.fixture(scope="module")
def split(scenes: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bop(scenes, tmp_path_factory.mktemp("bop"))


@pytest.mark.parametrize("number", [1, 2])
def test_what_is_written_is_read(scenes: list[Path], split: Path, number: int) -> None:
    true, frame = load_frame(scenes[number - 1]), load_bop(split, number, 0)
    np.testing.assert_allclose(frame.depth, true.depth, atol=1e-4)
    np.testing.assert_allclose(frame.camera.T_world_camera, true.camera.T_world_camera, atol=1e-6)
    np.testing.assert_allclose(frame.camera.K, true.camera.K)
    np.testing.assert_array_equal(frame.rgb, true.rgb)
    np.testing.assert_array_equal(frame.labels, true.labels)  # objects are numbered in the order of the truth
    np.testing.assert_array_equal(load_bop(split.parent, number, 0).labels, true.labels)


def test_poses_and_models_are_metric(scenes: list[Path], split: Path) -> None:
    import trimesh

    truth, frame = load_truth(scenes[0]), load_bop(split, 1, 0)
    assert bop_images(split) == [(1, 0), (2, 0)]
    for item, true in zip(bop_objects(split, 1, 0), truth.objects):
        np.testing.assert_allclose(
            frame.camera.T_world_camera @ item.T_camera_object, true.T_world_object, atol=1e-6
        )
        mesh = trimesh.load(item.model, force="mesh")
        mesh.apply_scale(0.001)
        mesh.apply_transform(true.T_world_object)
        np.testing.assert_allclose(mesh.bounds, truth.meshes[true.label].bounds, atol=1e-4)


def test_what_is_not_there_is_named(split: Path, tmp_path: Path) -> None:
    with pytest.raises(FrameError, match="no scene 000007"):
        load_bop(split, 7, 0)
    with pytest.raises(FrameError, match="no image 9"):
        load_bop(split, 1, 9)
    with pytest.raises(DataError, match="no scene of BOP's layout"):
        bop_images(tmp_path)


def test_map_reads_a_data_set(split: Path, tmp_path: Path) -> None:
    assert main(["map", "--bop", str(split), "1", "0", "--out", str(tmp_path / "map")]) == 0
    found = {item["name"] for item in json.loads((tmp_path / "map" / "scene.json").read_text())["objects"]}
    assert found == {"obj_000001", "obj_000002"}


@pytest.mark.slow
def test_evaluate_reads_a_data_set(split: Path, tmp_path: Path) -> None:
    options = ["--methods", "contramap", "--seeds", "0", "--gallery", "0", "--limit", "1"]
    assert main(["evaluate", "--bop", str(split), "--out", str(tmp_path / "evaluation"), *options]) == 0
    summary = json.loads((tmp_path / "evaluation" / "summary.json").read_text())
    assert summary["scenes"] == 1
    assert summary["methods"]["contramap"]["iou"]["mean"] > 0.4
    assert main(["evaluate", "--out", str(tmp_path / "nothing")]) == 2
