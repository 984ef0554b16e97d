"""Maps of many points with kernels of several widths: dense sums, label noise, far away, bad input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from mapping.config import ModelConfig
from mapping.contramap import ContraMap
from mapping.errors import ConfigError, DataError
from mapping.kernels import blocks, dense_features
from mapping.label_noise import disagreement, wrong_label_share
from mapping.multiscale import MultiscaleConfig, MultiscaleMap, hinges_near, noise_around
from mapping.sparse_features import sparse_features

RNG = np.random.default_rng(0)


def street(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A floor (0), a wall on it at y = 4 (1) and a post (2); [m]."""
    rng = np.random.default_rng(seed)
    floor = np.column_stack(
        [rng.uniform(0, 12, count), rng.uniform(-4, 4, count), rng.normal(0, 0.01, count)]
    )
    wall = np.column_stack([rng.uniform(0, 12, count), np.full(count, 4.0), rng.uniform(0.1, 3, count)])
    some = max(count // 20, 1)
    post = np.column_stack([rng.normal(6, 0.05, (some, 2)) - [0, 6], rng.uniform(0.1, 2, some)])
    labels = np.repeat([0, 1, 2], [count, count, some])
    return np.concatenate([floor, wall, post]), labels


@pytest.fixture(scope="module")
def fitted() -> MultiscaleMap:
    X, y = street(3000)
    return MultiscaleMap().fit(X, y, 3, np.random.default_rng(1))


def test_the_map_knows_the_street_and_not_the_sky(fitted):
    X, y = street(800, seed=1)
    known, uncertain = fitted.predict_known(X)
    np.testing.assert_allclose(known.sum(1), 1, atol=1e-5)
    assert (known.argmax(1) == y).mean() > 0.98
    sky = np.column_stack([RNG.uniform(0, 12, 50), RNG.uniform(-4, 4, 50), RNG.uniform(6, 20, 50)])
    assert fitted.predict_known(sky)[1].min() > 0.9 > np.median(uncertain)


def test_sparse_features_of_scales_are_the_dense_ones():
    X, _ = street(300)
    X = X.astype(np.float32)
    hinges = hinges_near(X, MultiscaleConfig())
    found = sparse_features(X, hinges.points, hinges.gamma, 3e-3, torch.device("cpu"))
    W = RNG.normal(size=(len(hinges.points), 2)).astype(np.float32)
    squared = ((X[:, None, :].astype(float) - hinges.points) ** 2).sum(2)
    phi = np.exp(-hinges.gamma * squared)
    phi[phi <= 3e-3] = 0
    out = np.empty((len(X), 2))
    out[found.order.numpy()] = found.times(torch.from_numpy(W)).numpy()
    np.testing.assert_allclose(out, phi @ W, atol=2e-3)
    np.testing.assert_allclose(np.sort(found.strongest.numpy()), np.sort(phi.max(1)), atol=1e-4)


def test_lattice_and_points_agree(fitted):
    axes = (np.array([3.0, 6.0]), np.array([0.0, 3.9]), np.array([0.0, 1.0, 2.0]))
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    lattice = fitted.predict_lattice(axes).reshape(-1, 4)
    np.testing.assert_allclose(lattice, fitted.predict_proba(points), atol=0.05)


def test_wrong_labels_are_mended():
    X, y = street(3000)
    rng = np.random.default_rng(2)
    noisy = np.where(rng.random(len(y)) < 0.3, (y + rng.integers(1, 3, len(y))) % 3, y)
    assert wrong_label_share(X, noisy, [1.0]) == pytest.approx(0.3, abs=0.05)
    assert wrong_label_share(X, y, [0.2, 0.5]) < 0.03
    test, truth = street(500, seed=3)
    for uncertain in (True, False):
        model = MultiscaleMap(uncertain=uncertain).fit(X, noisy, 3, np.random.default_rng(1))
        assert (
            model.predict_known(test)[0].argmax(1) == truth
        ).mean() > 0.85  # of labels that are right in 0.7


def test_disagreement_counts_the_others_of_a_cell():
    X = np.array([[0.1, 0.1], [0.2, 0.2], [0.3, 0.3], [5.0, 5.0]])
    np.testing.assert_allclose(disagreement(X, np.array([0, 0, 1, 1]), 1.0), [0.5, 0.5, 1.0, 0.0])
    assert wrong_label_share(X, np.array([0, 0, 1, 1]), [1.0]) == 0.0  # too few points in any cell


def test_same_seed_same_map_and_files(tmp_path, fitted):
    X, y = street(3000)
    again = MultiscaleMap().fit(X, y, 3, np.random.default_rng(1))
    asked = X[::50]
    np.testing.assert_array_equal(again.predict_proba(asked), fitted.predict_proba(asked))
    fitted.save(tmp_path / "map.npz")
    loaded = MultiscaleMap().load(tmp_path / "map.npz")
    np.testing.assert_allclose(loaded.predict_proba(asked), fitted.predict_proba(asked), atol=1e-6)


def test_noise_lies_around_the_hinge_points():
    config = MultiscaleConfig()
    hinges = hinges_near(street(200)[0], config)
    noise = noise_around(hinges, config, 500, np.random.default_rng(0))
    widest = hinges.points[hinges.gamma == hinges.gamma.min()]
    gap = np.abs(noise[:, None] - widest).max(2).min(1)
    assert gap.max() <= 1.5 * max(config.spacings) + 1e-5


def test_amplitudes_lower_the_penalty():
    X = RNG.uniform(0, 1, (400, 2)).astype(np.float32)
    y = (X[:, 0] > 0.5).astype(np.int64)
    hinges = np.array([[0.25, 0.5], [0.75, 0.5]], np.float32)
    strong, weak = (
        ContraMap(ModelConfig(l2=1e-2)).fit(X, y, hinges, 10.0, amplitude=np.full(2, a)) for a in (1.0, 0.1)
    )
    assert strong.W.abs().max() > 3 * weak.W.abs().max()
    with pytest.raises(DataError, match="amplitude"):
        ContraMap(ModelConfig()).fit(X, y, hinges, 10.0, amplitude=np.zeros(2))


def test_blocks_find_all_that_is_near_however_many_there_are():
    X = RNG.uniform(0, 40, (900, 2)).astype(np.float32)
    hinges = RNG.uniform(0, 40, (700, 2)).astype(np.float32)
    gamma = np.full(700, 2.0, np.float32)
    total = np.zeros(len(X))
    for rows, near in blocks(X, hinges, gamma, 1e-7):
        tensors = (torch.from_numpy(a) for a in (X[rows], hinges[near], gamma[near]))
        total[rows] += dense_features(*tensors).sum(1).numpy()
    every = np.exp(-2.0 * ((X[:, None].astype(float) - hinges) ** 2).sum(2)).sum(1)
    np.testing.assert_allclose(total, every, atol=1e-3)


def test_bad_input_is_refused():
    with pytest.raises(ConfigError, match="as many numbers"):
        MultiscaleMap(replace(MultiscaleConfig(), amplitudes=(1.0,)))
    with pytest.raises(DataError, match=r"\(N, 3\)"):
        MultiscaleMap().fit(np.zeros((4, 2)), np.zeros(4, int), 2, RNG)
    with pytest.raises(DataError, match="as many labels"):
        MultiscaleMap().fit(np.zeros((4, 3)), np.zeros(3, int), 2, RNG)
    with pytest.raises(DataError, match="not fitted"):
        MultiscaleMap().predict_known(np.zeros((1, 3)))
