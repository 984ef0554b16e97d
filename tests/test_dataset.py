"""Scene folders: complete, reproducible, resumable, and true."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from mapping.errors import ConfigError, DataError
from perception.camera import transform
from perception.frame import Frame
from perception.frame_io import load_frame
from reconstruction import metrics
from sim_scenes import dataset
from sim_scenes.objects import random_urdfs, ycb
from sim_scenes.truth import load_truth

pytest.importorskip("pybullet", reason="pybullet is not installed (extra `sim`, Python 3.10 or 3.11)")

SHARED = Path(__file__).resolve().parent.parent / "../shared/data/ycb"


def generate(out: Path, **settings) -> list[Path]:
    return dataset.generate(
        out, **{"count": 1, "seed": 3, "objects": "builtin", "progress": False, **settings}
    )


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return generate(tmp_path_factory.mktemp("scenes"), views=2)[0]


def files_of(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_the_scene_folder_is_a_frame_folder(scene: Path) -> None:
    frame, truth = load_frame(scene), load_truth(scene)
    assert frame.rgb is not None
    assert frame.labels is not None
    assert frame.depth.shape == (480, 640)
    assert [item.label for item in truth.objects] == list(range(1, len(truth.objects) + 1))
    assert 3 <= len(truth.objects) <= 10
    assert truth.views == (scene, scene / "views/1")
    for item in truth.objects:
        assert (frame.labels == item.label).sum() >= dataset.MIN_VISIBLE_PIXELS
        assert frame.name_of(item.label) == item.name
        assert item.watertight


@pytest.mark.parametrize("view", [0, 1])
def test_frames_agree_with_the_truth(scene: Path, view: int) -> None:
    truth = load_truth(scene)
    frame = load_frame(truth.views[view])
    assert frame.labels is not None
    points = transform(frame.camera.T_world_camera, frame.camera.back_project(frame.depth))
    for label, mesh in truth.meshes.items():
        seen = points[frame.labels == label]
        if len(seen):
            assert metrics.distance_to_surface(mesh, seen).max() < 1e-3
    table = points[(frame.labels == 0) & (np.abs(points).max(axis=-1) < 0.3)]
    assert np.abs(table @ truth.plane[:3] + truth.plane[3]).max() < 1e-3


def test_the_table_holds_the_objects(scene: Path) -> None:
    for mesh in load_truth(scene).meshes.values():
        assert mesh.bounds[0, 2] > -0.002
        assert mesh.volume > 0


def test_same_seed_gives_the_same_files(scene: Path, tmp_path: Path) -> None:
    again = generate(tmp_path / "again", views=2)[0]
    assert files_of(again) == files_of(scene)


def test_finished_scenes_are_kept_and_missing_ones_made(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "scenes"
    shutil.copytree(scene, out / "scene_0000")
    made = []
    monkeypatch.setattr(dataset, "make_scene", lambda folder, *_: made.append(folder.name))
    generate(out, views=2, count=2)
    assert made == ["scene_0001"]


def test_an_interrupted_scene_leaves_nothing_that_looks_finished(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save, saved = dataset.save_frame, []

    def stop_at_second_view(frame: Frame, folder: Path, depth_scale: float) -> None:
        if saved:
            raise KeyboardInterrupt
        save(frame, folder, depth_scale)
        saved.append(frame)

    monkeypatch.setattr(dataset, "save_frame", stop_at_second_view)
    with pytest.raises(KeyboardInterrupt):
        generate(tmp_path, views=2, seed=4)
    assert not (tmp_path / "scene_0000").exists()
    # Another seed is another scene.
    assert not np.array_equal(saved[0].depth, load_frame(scene).depth)
    assert list(tmp_path.iterdir()) == []


def test_scenes_of_other_settings_are_not_mixed(scene: Path) -> None:
    with pytest.raises(ConfigError, match="other settings"):
        generate(scene.parent, views=1)


def test_a_strange_folder_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "scene_0000").mkdir()
    (tmp_path / "scene_0000" / "thesis.txt").write_text("mine")
    with pytest.raises(ConfigError, match="no scene"):
        generate(tmp_path)
    assert (tmp_path / "scene_0000" / "thesis.txt").read_text() == "mine"


@pytest.mark.slow
def test_noise_changes_depth_and_labels_but_not_the_truth(scene: Path, tmp_path: Path) -> None:
    noisy = generate(tmp_path, views=1, sensor_noise=True, label_noise=True)[0]
    clean_frame, noisy_frame = load_frame(scene), load_frame(noisy)
    assert clean_frame.labels is not None
    assert noisy_frame.labels is not None
    both = np.isfinite(clean_frame.depth) & np.isfinite(noisy_frame.depth) & (clean_frame.depth < 1.2)
    error = np.abs(clean_frame.depth - noisy_frame.depth)[both]
    assert 2e-4 < np.median(error) < 4e-3
    assert 0 < np.isnan(noisy_frame.depth).mean() - np.isnan(clean_frame.depth).mean() < 0.2
    changed = (clean_frame.labels != noisy_frame.labels).sum()
    assert 0 < changed < 0.5 * (clean_frame.labels > 0).sum()
    for clean, same in zip(load_truth(scene).objects, load_truth(noisy).objects):
        np.testing.assert_array_equal(clean.T_world_object, same.T_world_object)


@pytest.mark.parametrize(
    ("settings", "message"),
    [({"objects": "lego"}, "auto, ycb, builtin"), ({"count": 0}, "at least 1"), ({"views": 0}, "at least 1")],
)
def test_senseless_arguments_are_refused(tmp_path: Path, settings: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        generate(tmp_path, **settings)


def test_missing_scans_are_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ycb, "find_ycb", lambda directory=None: None)
    with pytest.raises(DataError, match="fetch ycb"):
        generate(tmp_path, objects="ycb")
    assert dataset.object_source("auto").kind == "builtin"


@pytest.mark.parametrize("content", ["{", "{}", '{"objects": [{}], "support_plane": [0, 0, 1, 0]}'])
def test_a_broken_truth_file_is_an_error(tmp_path: Path, content: str) -> None:
    (tmp_path / "truth.json").write_text(content)
    with pytest.raises(DataError, match=r"truth\.json"):
        load_truth(tmp_path)


def test_a_missing_truth_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="contramap scenes"):
        load_truth(tmp_path)


@pytest.mark.slow
@pytest.mark.skipif(not ycb.list_models(SHARED), reason="no real YCB scans in ../shared/data/ycb")
def test_scenes_of_real_scans(tmp_path: Path) -> None:
    folder = generate(tmp_path, objects="ycb", ycb_dir=SHARED, views=1, seed=1)[0]
    truth, frame = load_truth(folder), load_frame(folder)
    assert frame.labels is not None
    points = transform(frame.camera.T_world_camera, frame.camera.back_project(frame.depth))
    for label, mesh in truth.meshes.items():
        assert metrics.distance_to_surface(mesh, points[frame.labels == label]).max() < 1e-3
        assert mesh.bounds[0, 2] > -0.004
    # The scans moved: another folder can be named.
    moved = json.loads((folder / "truth.json").read_text())
    moved["ycb_dir"] = "/nowhere"
    (folder / "truth.json").write_text(json.dumps(moved))
    assert load_truth(folder, SHARED).objects[0].mesh_path.is_file()


@pytest.mark.slow
def test_block_figures_make_scenes_of_their_own(tmp_path: Path) -> None:
    folder = generate(tmp_path, objects="figures", seed=5)[0]
    truth = load_truth(folder)
    assert all(item.name.startswith("figure_") and item.watertight for item in truth.objects)
    assert all(0.02 < mesh.extents.max() < 0.25 for mesh in truth.meshes.values())
    assert all(mesh.bounds[0, 2] > -2e-3 for mesh in truth.meshes.values())  # they rest on the table


def test_a_figure_whose_file_holds_nan_is_passed_over() -> None:
    assert random_urdfs._load("168") is None  # as pybullet ships it
    assert random_urdfs._load("169") is not None
