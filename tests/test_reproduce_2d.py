"""The reproductions in the plane on tiny settings: files, keys, resuming, bad input; real logs if at hand."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_lidar import flaser, square_room

from mapping.baselines.deep_map import DeepMapConfig
from mapping.baselines.dnn_gp import GaussianLayerConfig
from mapping.baselines.gaussian_process import GaussianProcessConfig
from mapping.baselines.residual_network import NetworkConfig
from mapping.errors import ConfigError, DataError
from perception.lidar import BeamConfig
from sim_scenes.toy2d import ToyConfig
from tools.markdown import markdown_table
from tools.occupancy.fit import share_occupied
from tools.reproduce import landscape as landscape_module
from tools.reproduce.commands import occupancy
from tools.reproduce.hinges import HingesConfig, run_hinges
from tools.reproduce.landscape import LANDSCAPES, PAPER_LOGS, Landscape, load_log, split_log
from tools.reproduce.occupancy import run_occupancy
from tools.reproduce.occupancy_methods import METHODS, OccupancyConfig
from tools.reproduce.runs import seconds, timed
from tools.reproduce.toy import run_toy
from tools.reproduce.toy_methods import METHODS as TOY_METHODS
from tools.reproduce.toy_methods import ToyStudyConfig
from tools.runs.kept import cached_run

RADISH = Path(__file__).parents[1] / ".." / "shared" / "data" / "radish"
TINY_TOY = ToyStudyConfig(
    data=ToyConfig(points=120, outliers=30),
    grid=12,
    network=NetworkConfig(width=24, layers=2, epochs=3, learning_rate=1e-3),
    layer=GaussianLayerConfig(features=32),
    gaussian_process=GaussianProcessConfig(length_scale=0.8, signal=2.5),
    passes=3,
    members=2,
)


@pytest.fixture
def room_log(tmp_path, monkeypatch) -> Path:
    """A folder with a made-up log of a square room, known as 'room'."""
    log = square_room(30, 40)
    lines = [flaser(ranges, pose) for ranges, pose in zip(log.ranges, log.poses)]
    (tmp_path / "room.log").write_text("\n".join([*lines, "FLASER 3 1"]))
    room = Landscape((-5.0, -5.0), (5.0, 5.0), (14, 14))
    monkeypatch.setitem(landscape_module.LANDSCAPES, "room", room)
    monkeypatch.setitem(__import__("tools.reproduce.occupancy", fromlist=["x"]).PAPER_AUC, "room", (1.0,) * 3)
    return tmp_path


def test_landscapes_have_the_papers_hinge_counts():
    counts = {name: len(landscape.hinges) for name, landscape in LANDSCAPES.items()}
    assert {name: counts[name] for name in PAPER_LOGS} == {
        "belgioioso": 8400,
        "edmonton": 8800,
        "fhw": 5940,
        "intel": 5600,
        "mexico": 7500,
    }
    np.testing.assert_allclose(LANDSCAPES["intel"].spacing, 0.5)
    assert LANDSCAPES["intel"].gamma(6.71 * 0.25) == pytest.approx(6.71)


def test_fewer_hinges_cover_the_same_rectangle():
    whole = LANDSCAPES["intel"]
    few = whole.with_hinges(700)
    assert len(few.hinges) == pytest.approx(700, rel=0.05)
    assert (few.low, few.high) == (whole.low, whole.high)
    assert few.spacing.max() / few.spacing.min() < 1.2
    assert whole.inside(few.hinges).all()


def test_split_puts_noise_everywhere_and_counts_what_is_outside():
    room = Landscape((-5.0, -5.0), (3.0, 5.0), (8, 10))
    split = split_log(square_room(40, 30), room, BeamConfig(), 1, np.random.default_rng(0))
    assert len(split.noise) == len(split.X)
    assert split.outside > 0
    assert split.X[:, 0].max() <= 3.0
    np.testing.assert_allclose(split.noise.mean(axis=0), [-1.0, 0.0], atol=0.5)


def test_occupancy_writes_table_figures_and_keys(room_log):
    out = room_log / "out"
    config = OccupancyConfig(query_per_hinge=2)
    summary = run_occupancy(room_log, out, ("room",), METHODS, (0, 1), config)
    assert json.loads((out / "summary.json").read_text()) == summary
    assert summary["corrupt_lines"] == {"room": 1}
    for method in METHODS:
        found = summary["logs"]["room"][method]
        assert set(found["auc"]) == {"mean", "std", "median"}
        assert found["auc"]["mean"] > 0.95
        assert found["train_s"]["mean"] > 0
        assert found["infer_s"]["mean"] > 0
    assert (out / "table.md").read_text().count("\n") == 2 + len(METHODS)
    for picture in ("room_methods.png", "room_classes.png"):
        assert 1000 < (out / picture).stat().st_size < 300_000


def test_occupancy_resumes_and_notices_other_settings(room_log):
    out = room_log / "out"
    config = OccupancyConfig(query_per_hinge=1)
    run_occupancy(room_log, out, ("room",), ("contramap",), (0,), config)
    run = out / "runs" / "room-contramap-0.json"
    written = run.stat().st_mtime_ns
    run_occupancy(room_log, out, ("room",), ("contramap",), (0,), config)
    assert run.stat().st_mtime_ns == written
    run_occupancy(room_log, out, ("room",), ("contramap",), (0,), replace(config, bayesian_iterations=9))
    assert run.stat().st_mtime_ns == written  # a setting of another method
    run_occupancy(room_log, out, ("room",), ("contramap",), (0,), replace(config, noise_weight=0.5))
    assert run.stat().st_mtime_ns > written


@pytest.mark.slow
def test_merged_samples_give_nearly_the_same_map(room_log):
    every = OccupancyConfig(query_per_hinge=2, merge_data=0.0, merge_noise=0.0)
    drawn = {}
    for name, config in {"every": every, "merged": OccupancyConfig(query_per_hinge=2)}.items():
        run_occupancy(room_log, room_log / name, ("room",), ("contramap",), (0,), config)
        with np.load(room_log / name / "runs" / "room-contramap-0.npz") as stored:
            drawn[name] = stored["probabilities"].astype(float)
    assert np.abs(drawn["every"] - drawn["merged"]).mean() < 0.02


def test_the_command_can_keep_every_sample(room_log):
    out = room_log / "out"
    occupancy(data=room_log, out=out, logs=("room",), methods=("hilbert",), repeats=1, keep_every_sample=True)
    settings = json.loads((out / "runs" / "room-hilbert-0.json").read_text())["settings"]
    assert settings["merge_data"] == settings["merge_noise"] == 0.0


def test_timed_repeats_what_is_quick_and_keeps_the_result():
    calls: list[int] = []
    result, figures = timed("add", lambda: calls.append(1) or len(calls), least_s=60.0, most=4)
    assert result == len(calls) == 4
    assert set(figures) == {"add_s", "add_cpu_s"}
    assert timed("once", lambda: 7, least_s=0.0)[0] == 7


def test_contramap_is_uncertain_outside_the_room_only(room_log):
    out = room_log / "out"
    run_occupancy(room_log, out, ("room",), ("contramap",), (0,), OccupancyConfig(query_per_hinge=2))
    with np.load(out / "runs" / "room-contramap-0.npz") as stored:
        uncertain = stored["probabilities"][..., 2].astype(float)
    x, y = LANDSCAPES["room"].query_axes(2)
    distance = np.maximum(np.abs(x)[:, None], np.abs(y))
    assert uncertain[distance > 4.7].min() > uncertain[distance < 3.0].max()


def test_hinges_study_covers_every_method_and_count(room_log):
    out = room_log / "hinges"
    config = HingesConfig(network=DeepMapConfig(epochs=2, width=8), query_step=1.0)
    summary = run_hinges(room_log, out, "room", (36, 100), seeds=(0,), config=config)
    assert set(summary["methods"]) == {"contramap_0", "contramap_1", "contramap_2", "bayesian_hilbert"}
    for counts in summary["methods"].values():
        assert set(counts) == {"36", "100"}
    assert (out / "hinges.png").stat().st_size > 1000
    assert (out / "table.md").read_text().count("\n") == 2 + 8


def test_toy_study_writes_every_figure(tmp_path):
    summary = run_toy(tmp_path, ("two_moons",), seeds=(0, 1), config=TINY_TOY)
    methods = summary["sets"]["two_moons"]
    assert tuple(methods) == TOY_METHODS
    assert methods["gp"]["spearman_gp"]["mean"] == pytest.approx(1.0)
    for method in TOY_METHODS:
        assert 0.0 <= methods[method]["ood_auroc"]["mean"] <= 1.0
        assert -1.0 <= methods[method]["spearman_gp"]["mean"] <= 1.0
    assert methods["contramap"]["ood_auroc"]["mean"] > 0.95
    assert methods["contramap"]["spearman_gp"]["mean"] > 0.8
    assert (tmp_path / "uncertainty.png").stat().st_size > 1000
    written = {path: path.stat().st_mtime_ns for path in (tmp_path / "runs").glob("*.json")}
    assert len(written) == 12
    assert run_toy(tmp_path, ("two_moons",), seeds=(0, 1), config=TINY_TOY) == summary
    assert {path: path.stat().st_mtime_ns for path in written} == written


def test_the_reference_runs_even_when_it_was_not_asked_for(tmp_path):
    summary = run_toy(tmp_path, ("two_ovals",), ("contramap",), (3,), TINY_TOY)
    assert set(summary["sets"]["two_ovals"]) == {"gp", "contramap"}


def test_bad_names_and_missing_data_are_one_clear_error(tmp_path):
    with pytest.raises(ConfigError, match="choose from two_ovals"):
        run_toy(tmp_path, ("five_moons",))
    with pytest.raises(ConfigError, match="choose from hilbert"):
        run_occupancy(tmp_path, tmp_path, ("intel",), ("magic",))
    with pytest.raises(ConfigError, match="intel"):
        run_hinges(tmp_path, tmp_path, "moon")
    with pytest.raises(DataError, match="intel-corrected"):
        run_occupancy(tmp_path, tmp_path / "out", ("intel",))


@pytest.mark.parametrize("content", ["{", "[]", '{"settings": {}}', "[" * 100_000])
def test_a_broken_run_is_computed_again(tmp_path, content):
    (tmp_path / "run.json").write_text(content)
    assert cached_run(tmp_path / "run.json", {}, lambda: {"a": 1}) == {"a": 1}
    assert cached_run(tmp_path / "run.json", {}, dict) == {"a": 1}
    assert cached_run(tmp_path / "run.json", {"b": 2}, dict) == {}


def test_share_occupied_ignores_the_uncertain_class():
    np.testing.assert_allclose(share_occupied(np.array([[0.1, 0.3, 0.6], [0.0, 0.0, 1.0]])), [0.75, 0.0])


def test_seconds_have_three_figures():
    assert [seconds(value) for value in (0.00123456, 0.5, 41.337, 1234.5)] == [
        "0.00123",
        "0.5",
        "41.3",
        "1230",
    ]


def test_markdown_table():
    assert markdown_table([["a", "b"], ["1", "2"]]) == "| a | b |\n| --- | --- |\n| 1 | 2 |\n"


@pytest.mark.skipif(not RADISH.is_dir(), reason="../shared/data/radish is absent: no real logs")
@pytest.mark.parametrize("name", LANDSCAPES)
def test_real_logs_are_read_and_their_landscape_holds_them(name):
    log, landscape = load_log(RADISH, name), LANDSCAPES[name]
    sources = json.loads((RADISH / "SOURCES.json").read_text())["datasets"]
    expected = sources[landscape_module.FILE_NAMES.get(name, name)]
    assert log.ranges.shape == (expected["scans"], expected["beams"][0])
    assert log.corrupt_lines == 0
    split = split_log(log, landscape, BeamConfig(), 1, np.random.default_rng(0))
    assert split.outside < 0.015 * (len(split.X) + len(split.X_test))


@pytest.mark.slow
@pytest.mark.skipif(not RADISH.is_dir(), reason="../shared/data/radish is absent: no real logs")
def test_contramap_keeps_up_with_the_hilbert_map_on_a_real_log(tmp_path):
    config = OccupancyConfig(query_per_hinge=1)
    summary = run_occupancy(RADISH, tmp_path, ("orebro",), ("hilbert", "contramap"), (0,), config)
    hilbert, contramap = (summary["logs"]["orebro"][m]["auc"]["mean"] for m in ("hilbert", "contramap"))
    assert contramap > 0.9
    assert contramap > hilbert - 0.003
