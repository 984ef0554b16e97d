"""The semantic study on a made-up street in SemanticKITTI's layout: protocols, keys, resuming, bad input."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_multiscale import street

from mapping.errors import ConfigError, DataError
from tools.cli import main
from tools.reproduce.semantic.protocols import BLOCK, has_protocol, make_case, mislabel
from tools.reproduce.semantic.run import miou, run_semantic
from tools.reproduce.semantic.scenes import load_scene

RAW = np.array([40, 50, 80], np.uint32)  # road, building, pole


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    return street_sequence(tmp_path_factory.mktemp("kitti"))


def street_sequence(folder: Path) -> Path:
    """A data set of one sequence with two scans of a street, the second one 1 m further on."""
    sequence = folder / "sequences" / "00"
    for part in ("velodyne", "labels"):
        (sequence / part).mkdir(parents=True)
    for scan in range(2):
        X, y = street(1200, seed=scan)
        X = X - [6.0 + scan, 0.0, 1.7]
        values = np.column_stack([X, np.zeros(len(X))]).astype(np.float32)
        (sequence / "velodyne" / f"{scan:06d}.bin").write_bytes(values.tobytes())
        (sequence / "labels" / f"{scan:06d}.label").write_bytes(RAW[y].tobytes())
    (sequence / "calib.txt").write_text("Tr: 0 -1 0 0 0 0 -1 0 1 0 0 0\n")
    (sequence / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 1\n")
    return folder


def test_the_command_measures_every_method_and_goes_on_where_it_stopped(data, tmp_path):
    arguments = ["reproduce", "semantic", "--data", str(data), "--sequences", "00", "--out", str(tmp_path)]
    arguments += ["--protocols", "points", "next", "labels30", "--json", str(tmp_path / "figures.json")]
    assert main(arguments) == 0
    sets = json.loads((tmp_path / "figures.json").read_text())["sets"]
    assert set(sets) == {"semantickitti", "semantickitti_next", "semantickitti_labels30"}
    for found in sets.values():
        assert set(found) == {"contramap", "hilbert", "nearest", "vote", "voxel"}
    assert sets["semantickitti"]["contramap"]["miou"]["mean"] > 0.9
    assert sets["semantickitti_next"]["contramap"]["miou"]["mean"] > 0.9
    assert sets["semantickitti"]["contramap"]["unobserved_auroc"]["mean"] > 0.9
    noisy = sets["semantickitti_labels30"]
    assert noisy["contramap"]["miou"]["mean"] > noisy["nearest"]["miou"]["mean"] + 0.1
    table = (tmp_path / "table.md").read_text()
    assert sum(line.startswith("|") for line in table.splitlines()) == 2 + 15
    written = {path: path.stat().st_mtime_ns for path in (tmp_path / "runs").glob("*.json")}
    assert len(written) == 15
    assert main(arguments) == 0
    assert {path: path.stat().st_mtime_ns for path in written} == written


def test_blocks_are_held_out_whole(data):
    case = make_case(load_scene(data, "semantickitti", "00"), "blocks", np.random.default_rng(0))
    trained = {tuple(cell) for cell in np.floor(case.X / BLOCK).astype(int)}
    asked = {tuple(cell) for cell in np.floor(case.X_test / BLOCK).astype(int)}
    assert asked
    assert not trained & asked


def test_the_last_scan_is_asked_of_the_first_and_of_all_before_it(data):
    scene = load_scene(data, "semantickitti", "00")
    assert has_protocol(scene, "next")
    assert not has_protocol(scene, "merged")
    scene = replace(scene, following=scene.following + scene.first)
    for protocol, count in (
        ("last", len(scene.X)),
        ("merged", len(scene.X) + len(scene.following[0].points)),
    ):
        case = make_case(scene, protocol, np.random.default_rng(0))
        assert len(case.X) == len(case.y) == count
        np.testing.assert_array_equal(np.sort(case.X_test, 0), np.sort(scene.first[0].points, 0))


def test_unobserved_places_are_far_from_returns_and_beams(data):
    scene = load_scene(data, "semantickitti", "00")
    case = make_case(scene, "points", np.random.default_rng(0))
    gap = np.linalg.norm(case.unobserved[:, None] - scene.X, axis=2).min(1)
    assert gap.min() >= 0.5
    assert len(case.unobserved) > 50


def test_labels_go_wrong_as_often_as_asked():
    y = np.random.default_rng(0).integers(0, 4, 4000)
    one = mislabel(y, np.arange(4000), 0.3, np.random.default_rng(1))
    assert (one != y).mean() == pytest.approx(0.3, abs=0.03)
    patch = np.arange(4000) // 100
    patches = mislabel(np.repeat(y[:40], 100), patch, 0.3, np.random.default_rng(1))
    wrong = (patches != np.repeat(y[:40], 100)).reshape(40, 100)
    assert (wrong.all(1) | ~wrong.any(1)).all()


def test_miou_is_of_the_classes_that_are_there():
    assert miou(np.array([0, 0, 1, 1]), np.array([0, 1, 1, 7])) == pytest.approx((1 / 2 + 1 / 3) / 2)


def test_bad_names_and_missing_data_are_one_clear_error(data, tmp_path):
    with pytest.raises(ConfigError, match="choose from semantickitti"):
        run_semantic(data, tmp_path, "mars")
    with pytest.raises(ConfigError, match="choose from points"):
        run_semantic(data, tmp_path, "semantickitti", ("magic",))
    with pytest.raises(DataError, match="no such sequence"):
        run_semantic(data, tmp_path, "semantickitti", sequences=("77",))
    with pytest.raises(DataError, match=r"room_89"):
        run_semantic(data, tmp_path, "scenenet")
