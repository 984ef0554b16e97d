"""The toy sets: sizes, seeds, geometry, and clusters that stay apart."""

from __future__ import annotations

import numpy as np
import pytest

from mapping.errors import ConfigError
from sim_scenes.toy2d import TOY_SETS, ToyConfig, make_toy_set


@pytest.mark.parametrize("name", TOY_SETS)
def test_a_seed_gives_one_set(name):
    first, again, other = (make_toy_set(name, np.random.default_rng(seed)) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first.X, again.X)
    np.testing.assert_array_equal(first.X_ood, again.X_ood)
    assert not np.array_equal(first.X, other.X)
    assert not np.array_equal(first.X, first.X_test)


@pytest.mark.parametrize("name", TOY_SETS)
def test_sizes_classes_and_box(name):
    toy = make_toy_set(name, np.random.default_rng(0), ToyConfig(points=301, outliers=40))
    assert toy.X.shape == toy.X_test.shape == (301, 2)
    assert toy.X_ood.shape == (40, 2)
    assert np.bincount(toy.y).tolist() == [151, 150]
    everything = np.concatenate([toy.X, toy.X_test, toy.X_ood])
    assert ((everything > toy.low) & (everything < toy.high)).mean() > 0.99


@pytest.mark.parametrize("name", TOY_SETS)
def test_the_unseen_cluster_is_away_from_the_data(name):
    toy = make_toy_set(name, np.random.default_rng(0))
    gaps = np.linalg.norm(toy.X_ood[:, None] - toy.X, axis=2).min(axis=1)
    assert gaps.mean() > 0.5


def test_moons_and_circles_lie_where_the_settings_say():
    quiet = ToyConfig(noise=0.0)
    circles = make_toy_set("two_circles", np.random.default_rng(0), quiet)
    np.testing.assert_allclose(np.linalg.norm(circles.X[circles.y == 0] - [-1.2, -0.7], axis=1), 1.0)
    np.testing.assert_allclose(np.linalg.norm(circles.X[circles.y == 1] - [1.15, -0.7], axis=1), 0.8)
    moons = make_toy_set("two_moons", np.random.default_rng(0), quiet)
    np.testing.assert_allclose(np.linalg.norm(moons.X[moons.y == 0] - [-0.1, 0.2], axis=1), 1.0)
    np.testing.assert_allclose(np.linalg.norm(moons.X[moons.y == 1] - [1.1, 0.3], axis=1), 1.0)


def test_unknown_set_names_the_choices():
    with pytest.raises(ConfigError, match="two_moons"):
        make_toy_set("three_moons", np.random.default_rng(0))
