"""What semantic maps cost: exponents, streets, tiles against one tile, killed workers, the command."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from test_reproduce_semantic import street_sequence

from tools.cli import main
from tools.semantic.agreement import print_of
from tools.semantic.scaling import city, exponents, streets


@pytest.fixture(scope="module")
def street_data(tmp_path_factory) -> Path:
    return street_sequence(tmp_path_factory.mktemp("kitti"))


def test_exponents_are_the_slopes_between_rows():
    rows = [
        {"samples": n, "steps": 10, "fit_cpu_s": n**1.5, "query_cpu_s": 2.0, "memory_mb": 3.0 * n}
        for n in (10, 100, 1000)
    ]
    found = exponents([*rows, {"samples": 10**4, "skipped": "out of memory"}], "samples")
    assert found["fit_cpu_s"] == pytest.approx(1.5)
    assert found["fit_cpu_s_steepest"] == pytest.approx(1.5)
    assert found["query_cpu_s"] == pytest.approx(0.0)
    assert found["memory_mb"] == pytest.approx(1.0)
    assert exponents(rows[:1], "samples") == {}


def test_streets_have_what_they_are_asked_for():
    X, y = streets(2000, 30.0, np.random.default_rng(0))
    assert X.shape == (2000, 3)
    assert (np.bincount(y) > 20).all()
    assert np.abs(X[y == 0, 2]).max() < 0.1
    assert len(np.unique(X[y == 1, 1])) == 3


def test_a_city_takes_as_much_more_as_it_has_more_points():
    row = {"samples": 1e6, "fit_cpu_s": 36.0, "memory_mb": 500.0, "map_mb": 1.0}
    found = city(row)
    assert found["cpu_hours"] == pytest.approx(100 * (70 / 60) ** 2)
    assert found["worker_mb_a_million"] == pytest.approx(500)


@pytest.mark.slow
def test_the_command_writes_table_and_figures(tmp_path):
    assert main(["benchmark", "semantic", "--out", str(tmp_path), "--samples", "200", "--scales", "2"]) == 0
    figures = json.loads((tmp_path / "benchmark.json").read_text())
    (row,) = figures["curves"]["together"]["rows"]
    assert row["samples"] == 200
    assert row["hinges"] > 50
    assert "processor hours" in (tmp_path / "table.md").read_text()


def test_too_few_samples_are_refused(tmp_path, capsys):
    assert main(["benchmark", "semantic", "--out", str(tmp_path), "--samples", "3"]) == 2
    assert "at least 100" in capsys.readouterr().err


def test_real_scans_need_data(tmp_path, capsys):
    for what in ("scan", "killed"):
        assert main(["benchmark", "semantic", "--out", str(tmp_path), "--what", what]) == 2
        assert "--data" in capsys.readouterr().err


def test_a_run_of_which_workers_were_killed_has_the_same_bytes_told_from_others(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name / "tiles").mkdir(parents=True)
        (tmp_path / name / "voxels.zarr").mkdir()
        (tmp_path / name / "tiles" / "0.npz").write_bytes(b"map")
        (tmp_path / name / f"{name}.killed").touch()  # of no tile
    assert print_of(tmp_path / "a") == print_of(tmp_path / "b")
    (tmp_path / "b" / "voxels.zarr" / "c").write_bytes(b"1")
    assert print_of(tmp_path / "a") != print_of(tmp_path / "b")


@pytest.mark.slow
def test_scans_tiles_and_killed_workers_on_a_street(street_data, tmp_path):
    arguments = ["benchmark", "semantic", "--data", str(street_data), "--sequences", "00", "--repeat", "1"]
    arguments += [
        "--what",
        "scan",
        "merged",
        "tiles",
        "killed",
        "--tolerances",
        "4e-4",
        "--out",
        str(tmp_path),
    ]
    assert main(arguments) == 0
    figures = json.loads((tmp_path / "benchmark.json").read_text())
    assert figures["scan"]["00"]["ask"]["asked"] == 5_000_000
    assert figures["merged"]["00"]["merged"]["points"] > figures["scan"]["00"]["fit"]["points"]
    assert [row["steps"] for row in figures["tiles"]] == [100, 0]
    assert figures["tiles"][0]["label_same"] > 0.99
    assert figures["tiles"][0]["away_same"] > 0.99
    assert figures["killed"]["worker_same"] == figures["killed"]["run_same"] == 1
    assert "the same bytes" in (tmp_path / "table.md").read_text()
