"""What a map refuses, in words: unfitted, shapes, units, far origins, odd map files; and axes that fall."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from solids import reconstructed_tabletop

from mapping import ContraMap, MapConfig, load_map
from mapping.baselines.bayesian_hilbert import BayesianHilbertMap
from mapping.baselines.deep_ensemble import DeepEnsemble
from mapping.baselines.deep_map import DeepMap
from mapping.baselines.dnn_gp import DnnGp
from mapping.baselines.gaussian_process import GaussianProcess
from mapping.baselines.mc_dropout import McDropout
from mapping.baselines.sngp import Sngp
from mapping.baselines.vprism import VPrism
from mapping.errors import DataError


@pytest.fixture(scope="module")
def fitted() -> ContraMap:
    rng = np.random.default_rng(0)
    X = rng.uniform(-5, 5, (800, 2))
    y = (np.hypot(X[:, 0] - 1, 0.7 * X[:, 1]) < 2).astype(int)
    return ContraMap(MapConfig(gamma=1.0, hinge_spacing=1.0)).fit(X, y)


@pytest.mark.parametrize("rows", [slice(None), slice(None, None, -1), [3, 0, 2, 1, 2], slice(5, 6)])
@pytest.mark.parametrize("columns", [slice(None), slice(None, None, -1)])
def test_axes_may_rise_fall_or_jump(fitted: ContraMap, rows, columns) -> None:
    xs, ys = np.linspace(-5, 5, 241)[columns], np.linspace(-6, 5, 31)[rows]
    points = np.stack(np.meshgrid(xs, ys, indexing="ij"), -1).reshape(-1, 2)
    expected = fitted.predict_proba(points).reshape(len(xs), len(ys), -1)
    np.testing.assert_allclose(fitted.predict_lattice((xs, ys)), expected, atol=2e-5)


def test_a_falling_axis_of_scattered_hinge_points() -> None:
    rng = np.random.default_rng(1)
    X = rng.uniform(-1, 1, (300, 3))
    scattered = ContraMap(MapConfig(gamma=4.0)).fit(X, (X[:, 0] > 0).astype(int), rng.uniform(-1, 1, (40, 3)))
    axes = [np.linspace(1, -1, 5), np.linspace(-1, 1, 6), np.linspace(1, -2, 7)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    expected = scattered.predict_proba(points).reshape(5, 6, 7, -1)
    np.testing.assert_allclose(scattered.predict_lattice(tuple(axes)), expected, atol=2e-5)


@pytest.mark.parametrize(
    "axes",
    [(), (np.arange(3.0),), (np.eye(2), np.eye(2)), (np.array([0, np.nan]), np.arange(2.0)), ("a", "b")],
)
def test_other_axes_are_refused(fitted: ContraMap, axes) -> None:
    with pytest.raises(DataError, match="axes"):
        fitted.predict_lattice(axes)


def test_an_empty_axis_gives_an_empty_lattice(fitted: ContraMap) -> None:
    assert fitted.predict_lattice((np.arange(3.0), np.empty(0))).shape == (3, 0, fitted.class_count)


def test_blocks_of_a_lattice_need_rising_axes(fitted: ContraMap) -> None:
    with pytest.raises(DataError, match="rise"):
        fitted.lattice().on((np.arange(3.0), np.arange(3.0)[::-1]))


@pytest.mark.parametrize(
    "ask",
    [
        lambda model: model.predict_proba(np.zeros((3, 2))),
        lambda model: model.predict_lattice((np.arange(3.0), np.arange(3.0))),
        lambda model: model.predict_occupancy(np.zeros((3, 2))),
        lambda model: model.lattice(),
        lambda model: model.save("map.npz"),
    ],
)
def test_an_unfitted_map_says_so(ask: Callable[[ContraMap], object]) -> None:
    with pytest.raises(DataError, match="not fitted"):
        ask(ContraMap())


@pytest.mark.parametrize(
    "model",
    [
        BayesianHilbertMap(),
        DeepMap(),
        GaussianProcess(),
        McDropout(),
        DeepEnsemble(),
        DnnGp(),
        Sngp(),
        VPrism(),
    ],
    ids=lambda model: type(model).__name__,
)
def test_unfitted_baselines_say_so_and_can_still_be_copied(model: Any) -> None:
    with pytest.raises(DataError, match=f"{type(model).__name__} is not fitted"):
        model.predict_proba(np.zeros((2, 2)))
    assert not hasattr(model, "weights_that_nobody_has")
    assert type(copy.deepcopy(pickle.loads(pickle.dumps(model)))) is type(model)


@pytest.mark.parametrize(
    ("X", "y", "more", "message"),
    [
        (np.zeros((0, 2)), np.zeros(0, int), {}, "no points"),
        (np.zeros(4), np.zeros(4, int), {}, "shape"),
        (np.zeros((4, 0)), np.zeros(4, int), {}, "shape"),
        (np.full((4, 2), 1e39), np.zeros(4, int), {}, "float32"),
        (np.array([["a", "b"]]), np.zeros(1, int), {}, "numbers"),
        (np.zeros((4, 2)), np.array(["a"] * 4), {}, "numbers"),
        (np.zeros((4, 2)), np.array([0, 1, 0.5, 1]), {}, "whole"),
        (np.zeros((4, 2)), np.full((4, 3), np.nan), {}, "finite"),
        (np.zeros((4, 2)), -np.ones((4, 3)), {}, ">= 0"),
        (np.zeros((4, 2)), np.zeros(4, int), {"gamma": np.ones(3), "hinges": np.zeros((4, 2))}, "gamma"),
        (np.zeros((4, 2)), np.zeros(4, int), {"gamma": -1.0, "hinges": np.zeros((4, 2))}, "gamma"),
    ],
)
def test_other_training_data_are_refused(X, y, more: dict, message: str) -> None:
    with pytest.raises(DataError, match=message):
        ContraMap().fit(X, y, **more)


def test_points_in_millimetres_are_noticed() -> None:
    X = np.random.default_rng(0).uniform(-500, 500, (2000, 3))
    y = (X[:, 2] > 0).astype(int)
    with pytest.raises(DataError, match="in metres"):
        ContraMap().fit(X, y)
    hinges = np.stack(np.meshgrid(*[np.arange(-500, 500, 50.0)] * 3), -1).reshape(-1, 3)
    with pytest.raises(DataError, match="same unit"):
        ContraMap().fit(X, y, hinges=hinges)


def test_points_in_map_coordinates_are_noticed() -> None:
    X = np.random.default_rng(0).uniform(-0.3, 0.3, (2000, 3)) + np.array([4e5, 5e6, 300])
    with pytest.raises(DataError, match="subtract a point"):
        ContraMap().fit(X, (X[:, 2] > 300).astype(int))


def test_a_point_far_from_all_others_is_uncertain_and_harms_nobody(fitted: ContraMap) -> None:
    X = np.array([[0.5, 0.5], [1e12, -3e30], [-1e20, 2.0]])
    p = fitted.predict_proba(X)
    np.testing.assert_allclose(p[0], fitted.predict_proba(X[:1])[0], atol=1e-6)
    np.testing.assert_allclose(p[1:, -1], 0.95, atol=1e-6)


@pytest.mark.parametrize(
    "points", [np.zeros(3), np.zeros((4, 2)), np.zeros((2, 3, 1)), [[0, 0, np.nan]], [["a", "b", "c"]], None]
)
def test_query_checks_its_points(points) -> None:
    with pytest.raises(DataError, match="points"):
        reconstructed_tabletop().query(points)


def test_query_of_nothing_and_of_lists() -> None:
    assert reconstructed_tabletop().query(np.empty((0, 3))).label.shape == (0,)
    assert reconstructed_tabletop().query([[0.0, 0.0, 0.5]]).uncertainty.shape == (1,)


CHANGES: dict[str, Callable[[dict[str, np.ndarray]], object]] = {
    "W transposed": lambda v: v.update(W=v["W"].T.copy()),
    "W flat": lambda v: v.update(W=v["W"].ravel()),
    "W with a class more": lambda v: v.update(W=np.pad(v["W"], ((0, 0), (0, 1)))),
    "W of whole numbers": lambda v: v.update(W=v["W"].astype(int)),
    "W NaN": lambda v: v.update(W=v["W"] * np.nan),
    "offset NaN": lambda v: v.update(offset=v["offset"] * np.nan),
    "offset longer": lambda v: v.update(offset=np.append(v["offset"], 0).astype(np.float32)),
    "offset empty": lambda v: v.update(offset=np.empty(0, np.float32), W=v["W"][:, :0]),
    "hinges one-dimensional": lambda v: v.update(hinges=v["hinges"][:, 0]),
    "hinges without coordinates": lambda v: v.update(hinges=v["hinges"][:, :0]),
    "hinges fewer": lambda v: v.update(hinges=v["hinges"][1:]),
    "no hinges": lambda v: v.update(hinges=v["hinges"][:0], gamma=v["gamma"][:0], W=v["W"][:0]),
    "hinges infinite": lambda v: v.update(hinges=v["hinges"] + np.inf),
    "hinges complex": lambda v: v.update(hinges=v["hinges"].astype(complex)),
    "hinges text": lambda v: v.update(hinges=v["hinges"].astype(str)),
    "gamma a number": lambda v: v.update(gamma=v["gamma"][0]),
    "gamma negative": lambda v: v.update(gamma=-v["gamma"]),
    "gamma zero": lambda v: v.update(gamma=0 * v["gamma"]),
    "losses square": lambda v: v.update(losses=np.eye(3)),
    "converged an array": lambda v: v.update(converged=np.array([True])),
    "format another": lambda v: v.update(format=np.array(99)),
    "format text": lambda v: v.update(format=np.array("1")),
    "format an array": lambda v: v.update(format=np.array([1])),
    "no format": lambda v: v.pop("format"),
    "no W": lambda v: v.pop("W"),
    "config no JSON": lambda v: v.update(config=np.array("{")),
    "config a list": lambda v: v.update(config=np.array("[]")),
    "config nested": lambda v: v.update(config=np.array("[" * 100_000)),
    "config without fit": lambda v: v.update(config=np.array("{}")),
    "config with more": lambda v: v.update(config=np.array('{"fit": {}, "colour": "red"}')),
    "config with nonsense": lambda v: v.update(config=np.array('{"fit": [], "gamma": "x"}')),
    "config an array": lambda v: v.update(config=np.array(["{}", "{}"])),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES.keys())
def test_map_files_of_other_content_are_refused(fitted: ContraMap, tmp_path: Path, change) -> None:
    fitted.save(tmp_path / "map.npz")
    values = dict(np.load(tmp_path / "map.npz"))
    change(values)
    np.savez(tmp_path / "other.npz", **values)
    with pytest.raises(DataError, match=r"other\.npz") as caught:
        load_map(tmp_path / "other.npz")
    assert "\n" not in str(caught.value)
    assert [path.name for path in tmp_path.glob(".*")] == []


def test_a_map_in_other_precision_is_read(fitted: ContraMap, tmp_path: Path) -> None:
    fitted.save(tmp_path / "map.npz")
    values = dict(np.load(tmp_path / "map.npz"))
    np.savez(
        tmp_path / "double.npz",
        **{**values, "W": values["W"].astype(float), "hinges": values["hinges"].astype(float)},
    )
    X = np.random.default_rng(0).uniform(-5, 5, (50, 2))
    assert (load_map(tmp_path / "double.npz").predict_proba(X) == fitted.predict_proba(X)).all()
