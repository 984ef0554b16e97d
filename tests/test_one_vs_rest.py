"""Bayesian Hilbert maps of many classes against the binary map they are made of."""

from __future__ import annotations

import numpy as np
import pytest

from mapping.baselines.bayesian_hilbert import BayesianHilbertConfig, BayesianHilbertMap
from mapping.baselines.one_vs_rest import OneVsRestHilbertMap
from mapping.errors import DataError


def problem(count: int = 600) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (N, 3), three classes along x, and hinge points."""
    X = np.random.default_rng(3).uniform(-0.15, 0.15, (count, 3))
    y = np.digitize(X[:, 0], [-0.05, 0.05])
    axis = np.arange(-0.15, 0.16, 0.06)
    return X, y, np.stack(np.meshgrid(axis, axis, axis), -1).reshape(-1, 3)


@pytest.mark.parametrize("batch", [600, 250])
def test_each_class_is_a_binary_map(batch: int) -> None:
    X, y, hinges = problem()
    config = BayesianHilbertConfig(gamma=1000.0, batch=batch)
    together = OneVsRestHilbertMap(config).fit(X, y, hinges, np.random.default_rng(0))
    queries = np.random.default_rng(1).uniform(-0.3, 0.3, (500, 3))
    probability = together.predict_proba(queries)
    assert probability.shape == (500, 3)
    for k in range(3):
        alone = BayesianHilbertMap(config).fit(X, (y == k).astype(int), hinges, np.random.default_rng(0))
        np.testing.assert_allclose(probability[:, k], alone.predict_proba(queries)[:, 1], atol=2e-3)


def test_it_learns_and_a_class_without_points_is_nowhere() -> None:
    X, y, hinges = problem()
    model = OneVsRestHilbertMap(BayesianHilbertConfig(gamma=1000.0))
    probability = model.fit(X, y, hinges, np.random.default_rng(0), classes=4).predict_proba(X)
    assert (probability.argmax(1) == y).mean() > 0.9
    assert (probability[:, 3] < 0.5).all()


def test_more_classes_than_announced_are_refused() -> None:
    X, y, hinges = problem()
    with pytest.raises(DataError, match="announced"):
        OneVsRestHilbertMap().fit(X, y, hinges, np.random.default_rng(0), classes=2)
