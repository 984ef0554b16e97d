"""The result as an object: found by name, told in a line, saved, read back and asked at points."""

import json

import numpy as np
import pytest
from conftest import make_tabletop

from mapping.errors import ConfigError, DataError
from reconstruction import load_result, reconstruct


@pytest.fixture(scope="module")
def result():
    return reconstruct(make_tabletop(size=(160, 120)).frame)


@pytest.fixture(scope="module")
def folder(result, tmp_path_factory):
    return result.save(tmp_path_factory.mktemp("results") / "result")


def test_objects_are_found_by_name_and_label(result, folder):
    for holder in (result, load_result(folder)):
        first = holder.objects[0]
        assert holder[first.name] is first
        assert holder[first.label] is first
        assert [item.label for item in holder] == [item.label for item in holder.objects]
        with pytest.raises(DataError, match=first.name):
            holder["no such object"]


def test_a_name_that_two_objects_share_is_not_guessed(result):
    from dataclasses import replace

    twins = replace(result, objects=tuple(replace(item, name="twin") for item in result.objects))
    with pytest.raises(DataError, match="by its label: 1, 4"):
        twins["twin"]


def test_repr_is_a_line(result, folder):
    for shown in (result, result.objects[0], load_result(folder), load_result(folder).objects[0]):
        text = repr(shown)
        assert "\n" not in text
        assert len(text) < 300
        assert result.objects[0].name in text


def test_a_stored_result_answers_as_the_fresh_one(result, folder):
    points = np.concatenate([item.mesh.vertices[::50] for item in result.objects])
    points = np.concatenate([points, points + np.array([0, 0, 0.3]), points - np.array([0, 0, 0.2])])
    fresh, stored = result.query(points), load_result(str(folder)).query(points)
    assert set(np.unique(fresh.label)) >= {-1, 0, 1}
    np.testing.assert_array_equal(stored.label, fresh.label)
    for name in ("occupancy", "uncertainty", "gradient"):
        np.testing.assert_allclose(getattr(stored, name), getattr(fresh, name), atol=1e-6)
    with pytest.raises(DataError):
        load_result(folder).query(np.zeros((3, 2)))


def test_a_folder_that_does_not_say_what_its_columns_are(result, folder, tmp_path):
    from shutil import copytree

    old = copytree(folder, tmp_path / "old")
    scene = json.loads((old / "scene.json").read_text())
    del scene["map_labels"]
    (old / "scene.json").write_text(json.dumps(scene))
    stored = load_result(old)
    with pytest.raises(DataError, match="map_labels"):
        stored.query(np.zeros((1, 3)))


def test_exported_and_saved_meshes_keep_uncertainty_and_colours(result, folder, tmp_path):
    import trimesh

    item = result.objects[0]
    item.mesh.export(tmp_path / "fresh.ply")
    load_result(folder).objects[0].mesh.export(tmp_path / "stored.ply")
    item.save(tmp_path / "saved.ply")
    for name in ("fresh", "stored", "saved"):
        read = trimesh.load(tmp_path / f"{name}.ply", process=False)
        raw = read.metadata["_ply_raw"]["vertex"]["data"]
        np.testing.assert_array_equal(raw["uncertainty"].ravel(), item.uncertainty)
        assert len(np.unique(np.stack([raw[c].ravel() for c in ("red", "green", "blue")], 1), axis=0)) > 1
    np.testing.assert_array_equal(read.vertices, item.mesh.vertices)  # saved: to the last digit
    with pytest.raises(ConfigError, match=r"\.ply"):
        item.save(tmp_path / "saved.stl")
