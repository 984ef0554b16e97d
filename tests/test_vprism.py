"""V-PRISM against an independent dense float64 reference, and what a Gaussian posterior must do."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import expit

from mapping.baselines.vprism import VPrism, VPrismConfig, expected_softmax, normalised_entropy
from mapping.baselines.vprism_dense import DenseVPrism
from mapping.errors import ConfigError, DataError


def reference(X, y, hinges, classes, config):
    """The published updates, one class and one sample at a time, with explicit inverses; one batch."""
    X, hinges = X.astype(float), hinges.astype(float)
    phi = np.exp(-config.gamma * ((X[:, None] - hinges) ** 2).sum(2))
    phi = np.column_stack([phi, np.ones(len(X))])
    xi, alpha = np.ones((len(X), classes)), np.zeros(len(X))
    for _ in range(config.iterations):
        slope = (expit(xi) - 0.5) / (2 * xi)
        covariances, means = [], []
        for k in range(classes):
            precision = np.eye(phi.shape[1]) / config.prior_variance
            information = np.zeros(phi.shape[1])
            for n, row in enumerate(phi):
                precision += 2 * slope[n, k] * np.outer(row, row)
                information += ((y[n] == k) - 0.5 + 2 * alpha[n] * slope[n, k]) * row
            covariances.append(np.linalg.inv(precision))
            means.append(covariances[-1] @ information)
        m = phi @ np.array(means).T
        v = np.stack([np.einsum("nh,hi,ni->n", phi, S, phi) for S in covariances], 1)
        constant = 0.5 * (classes / 2 - 1)
        total = slope.sum(1)
        if config.alpha == "published":
            alpha = constant * (slope * m).sum(1) / total
        else:
            alpha = (constant + (slope * m).sum(1)) / total
        xi = np.sqrt(v + m**2 + alpha[:, None] ** 2 - 2 * alpha[:, None] * m)
    return np.array(means), m, v


def problem(count: int = 240, classes: int = 4):
    rng = np.random.default_rng(3)
    X = rng.uniform(-0.15, 0.15, (count, 3)).astype(np.float32)
    y = (X[:, 0] > 0).astype(np.int64) + 2 * (X[:, 1] > 0) if classes == 4 else (X[:, 0] > 0).astype(np.int64)
    axis = np.arange(-0.15, 0.16, 0.06)
    hinges = np.stack(np.meshgrid(axis, axis, axis), -1).reshape(-1, 3).astype(np.float32)
    return X, y, hinges


@pytest.mark.parametrize("alpha", ["published", "bound"])
def test_posterior_is_that_of_the_published_updates(alpha):
    X, y, hinges = problem()
    config = VPrismConfig(alpha=alpha)
    model = VPrism(config).fit(X, y, hinges, np.random.default_rng(0))
    weights, m, v = reference(X, y, hinges, 4, config)
    mean, variance = model.latent(X)
    np.testing.assert_allclose(mean, m, rtol=1e-3, atol=2e-3)
    np.testing.assert_allclose(variance, v, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(model.mu.numpy(), weights, atol=2e-3 * np.abs(weights).max())


def test_dropping_tiny_features_changes_nothing_that_matters():
    X, y, hinges = problem()
    queries = np.random.default_rng(1).uniform(-0.3, 0.3, (500, 3)).astype(np.float32)
    every, few = (
        VPrism(VPrismConfig(cutoff=cutoff)).fit(X, y, hinges, np.random.default_rng(0)).predict_proba(queries)
        for cutoff in (0.0, 1e-7)
    )
    np.testing.assert_allclose(few, every, atol=1e-3)


@pytest.mark.parametrize("alpha", ["published", "bound"])
def test_the_dense_formulation_gives_the_same_answers(alpha):
    X, y, hinges = problem(900)
    queries = np.random.default_rng(1).uniform(-0.3, 0.3, (5000, 3)).astype(np.float32)  # two blocks of rows
    config = VPrismConfig(alpha=alpha, batch=400)
    truncated, dense = (
        kind(config).fit(X, y, hinges, np.random.default_rng(0), classes=5) for kind in (VPrism, DenseVPrism)
    )
    np.testing.assert_allclose(dense.predict_proba(queries), truncated.predict_proba(queries), atol=1e-3)
    mean, variance = dense.latent(queries)
    expected_mean, expected_variance = truncated.latent(queries)
    np.testing.assert_allclose(mean, expected_mean, rtol=1e-3, atol=3e-3)
    np.testing.assert_allclose(variance, expected_variance, rtol=2e-3, atol=2e-3)


def test_batches_shrink_the_variance():
    X, y, hinges = problem(400)
    rng = np.random.default_rng
    one = VPrism(VPrismConfig()).fit(X[:100], y[:100], hinges, rng(0), classes=4)
    all_at_once = VPrism(VPrismConfig(batch=100)).fit(X, y, hinges, rng(0), classes=4)
    variance_one, variance_all = (model.latent(X)[1] for model in (one, all_at_once))
    assert (variance_all < variance_one + 1e-3).mean() > 0.99
    assert variance_all.mean() < 0.5 * variance_one.mean()


def test_it_learns_and_doubts_far_away():
    X, y, hinges = problem(800)
    model = VPrism().fit(X, y, hinges, np.random.default_rng(0))
    assert (model.predict_proba(X).argmax(1) == y).mean() > 0.95
    boundary = np.zeros((1, 3), np.float32)
    inside = np.full((1, 3), 0.08, np.float32)
    assert model.entropy(boundary)[0] > model.entropy(inside)[0] + 0.3


def test_expected_softmax_of_sure_logits_is_the_one_hot_and_of_vague_ones_uniform():
    mean = np.array([[30.0, 0, 0, 0], [0, 0, 0, 0]])
    sure = expected_softmax(mean, np.zeros_like(mean))
    np.testing.assert_allclose(sure, [[1, 0, 0, 0], [0.25] * 4], atol=1e-4)
    np.testing.assert_allclose(expected_softmax(mean, np.full_like(mean, 1e9)), 0.25, atol=1e-3)
    rng = np.random.default_rng(0)
    mean, variance = rng.normal(0, 3, (300, 5)), rng.uniform(0, 4, (300, 5))
    total = expected_softmax(mean, variance).sum(1)
    assert np.abs(total - 1).max() < 0.15  # an approximation, and a good one


def test_expected_softmax_is_near_the_average_over_samples():
    rng = np.random.default_rng(0)
    mean, variance = np.array([[1.0, 0.0, -1.0]]), np.array([[2.0, 1.0, 0.5]])
    draws = np.exp(mean + np.sqrt(variance) * rng.normal(size=(200_000, 3)))
    average = (draws / draws.sum(1, keepdims=True)).mean(0)
    np.testing.assert_allclose(expected_softmax(mean, variance)[0], average, atol=0.03)


def test_entropy_is_one_for_uniform_and_zero_for_one_hot():
    np.testing.assert_allclose(normalised_entropy(np.array([[0.25] * 4, [1.0, 0, 0, 0]])), [1, 0], atol=1e-9)


def test_refusals():
    X, y, hinges = problem()
    with pytest.raises(ConfigError, match="published"):
        VPrism(VPrismConfig(alpha="other"))  # type: ignore[arg-type]
    with pytest.raises(DataError, match="announced"):
        VPrism().fit(X, y, hinges, np.random.default_rng(0), classes=2)
