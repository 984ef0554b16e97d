"""Scenes of any folder of meshes: found, named, chosen by part and size, and refused with a reason."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from mapping.errors import ConfigError, DataError
from sim_scenes import dataset
from sim_scenes.object_source import object_source
from sim_scenes.objects.mesh_folder import FolderConfig, MeshFolder, mesh_files
from sim_scenes.objects.split import group_of, held_out, in_part
from sim_scenes.truth import load_truth
from tools.cli import main


def box(path: Path, size: tuple[float, float, float]) -> None:
    mesh = trimesh.creation.box(size)
    mesh.apply_translation([0, 0, size[2] / 2])
    path.parent.mkdir(parents=True, exist_ok=True)
    mesh.export(path)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    where = tmp_path / "meshes"
    box(where / "tea.ply", (0.06, 0.06, 0.09))
    box(where / "shop/soap.obj", (0.05, 0.07, 0.03))
    box(where / "shop/crate.ply", (0.3, 0.2, 0.1))
    box(where / "a/model.glb", (0.04, 0.08, 0.05))  # y is up in this format
    box(where / "b/model.ply", (0.05, 0.05, 0.05))
    (where / "readme.txt").write_text("no mesh")
    return where


def test_meshes_are_found_below_the_folder_and_named_uniquely(folder: Path) -> None:
    assert set(mesh_files(folder)) == {"tea", "soap", "crate", "a__model", "b__model"}
    box(folder / "tea.obj", (0.06, 0.06, 0.09))
    assert len(mesh_files(folder)) == 6


def test_meshes_whose_format_has_y_up_are_turned_upright(folder: Path) -> None:
    model = MeshFolder.open(folder).load("a__model")
    assert model is not None
    assert model.watertight
    assert model.mesh.volume > 0
    np.testing.assert_allclose(model.mesh.extents, [0.04, 0.05, 0.08], atol=1e-6)


def test_what_cannot_stand_on_a_table_is_passed_over_with_the_reason(folder: Path) -> None:
    box(folder / "tea_in_mm.ply", (60, 60, 90))
    open_box = trimesh.creation.box((0.05, 0.05, 0.05))
    open_box.update_faces(np.arange(len(open_box.faces)) > 1)
    open_box.export(folder / "open.ply")
    (folder / "broken.ply").write_text("ply\nnonsense")
    source = MeshFolder.open(folder, FolderConfig(max_size=0.2))
    names = {model.name for model in source.draw(20, np.random.default_rng(0))}
    assert names == {"tea", "soap", "a__model", "b__model"}
    assert "metres" in source.refused["tea_in_mm"]
    assert "watertight" in source.refused["open"]
    assert "cannot be read" in source.refused["broken"]
    assert "longer than 0.2 m" in source.refused["crate"]
    with pytest.raises(DataError, match="no mesh can be put on a table"):
        MeshFolder.open(folder, FolderConfig(max_size=0.01)).draw(3, np.random.default_rng(0))


def test_variants_of_one_product_fall_into_the_same_part() -> None:
    assert group_of("shelf/Blue_Marker_2.ply") == group_of("red_marker") == "marker"
    names = [f"{first}_{second}" for first in ("mug", "pan", "tray", "vase") for second in "abcdefghijklmnop"]
    share = np.mean([held_out(name) for name in names])
    assert 0.05 < share < 0.4
    assert all(in_part(n, "all") and in_part(n, "train") != in_part(n, "held-out") for n in names)
    with pytest.raises(ConfigError, match="held-out"):
        in_part("mug", "test")


def test_a_list_of_names_restricts_the_objects(folder: Path, tmp_path: Path) -> None:
    listing = tmp_path / "only.txt"
    listing.write_text("# for breakfast\ntea\nsoap\n")
    assert set(MeshFolder.open(folder, FolderConfig(only=listing)).files) == {"tea", "soap"}
    listing.write_text("coffee\n")
    with pytest.raises(ConfigError, match="'coffee' is no object of the folder"):
        MeshFolder.open(folder, FolderConfig(only=listing))


def test_senseless_choices_are_refused(tmp_path: Path, folder: Path) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(DataError, match="no meshes found"):
        MeshFolder.open(empty)
    with pytest.raises(ConfigError, match="neither a folder"):
        object_source(str(tmp_path / "nowhere"))
    with pytest.raises(ConfigError, match="choose from a folder"):
        object_source("builtin", config=FolderConfig(part="train"))
    with pytest.raises(ConfigError, match="max_size"):
        MeshFolder.open(folder, FolderConfig(max_size=-1.0))


def test_a_scene_of_a_folder_is_complete_and_records_its_objects(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    pytest.importorskip("pybullet", reason="pybullet is not installed (extra `sim`)")
    out = tmp_path / "scenes"
    command = ["scenes", str(out), "--count", "1", "--objects", str(folder), "--max-size", "0.2"]
    assert main(command) == 0
    assert "1 scenes" in capsys.readouterr().out
    truth = load_truth(out / "scene_0000")
    names = {item.name for item in truth.objects}
    assert names <= {"tea", "soap", "a__model", "b__model"}
    assert len(names) >= 3
    for item, mesh in zip(truth.objects, truth.meshes.values()):
        assert item.watertight
        assert mesh.bounds[0, 2] > -0.002
    choice = json.loads((out / dataset.OBJECTS_FILE).read_text())
    assert set(choice["in_scenes"]) == names
    assert choice["part"] == "all"
    assert "crate" in choice["candidates"]
    assert main([*command[:-1], "0.3"]) == 2  # other objects are another set of scenes
    assert "other settings" in capsys.readouterr().err
