"""The baselines in the plane: each learns its set, and each has a property of its own."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from mapping.baselines.base import UncertaintyClassifier, gini
from mapping.baselines.bayesian_hilbert import BayesianHilbertConfig, BayesianHilbertMap
from mapping.baselines.deep_ensemble import DeepEnsemble
from mapping.baselines.deep_map import DeepMap, DeepMapConfig
from mapping.baselines.dnn_gp import DnnGp, GaussianLayerConfig
from mapping.baselines.gaussian_process import GaussianProcess, GaussianProcessConfig
from mapping.baselines.hilbert import HilbertMap
from mapping.baselines.mc_dropout import McDropout
from mapping.baselines.residual_network import NetworkConfig
from mapping.baselines.sngp import Sngp
from mapping.config import MapConfig
from mapping.contramap import ContraMap
from mapping.errors import ConfigError, DataError
from sim_scenes.toy2d import ToyConfig, ToySet, make_toy_set

NETWORK = NetworkConfig(width=48, layers=3, learning_rate=3e-3, batch=64, epochs=25)
LAYER = GaussianLayerConfig(features=128)
MAKERS = {
    "gp": lambda: GaussianProcess(GaussianProcessConfig(search_points=80)),
    "mc_dropout": lambda: McDropout(NETWORK, passes=8),
    "deep_ensemble": lambda: DeepEnsemble(NETWORK, members=3),
    "dnn_gp": lambda: DnnGp(NETWORK, LAYER),
    "sngp": lambda: Sngp(NETWORK, LAYER),
}


@pytest.fixture(scope="module")
def moons() -> ToySet:
    return make_toy_set("two_moons", np.random.default_rng(0), ToyConfig(points=400, outliers=50))


@pytest.fixture(scope="module")
def fitted(moons) -> dict[str, UncertaintyClassifier]:
    return {name: make().fit(moons.X, moons.y, np.random.default_rng(1)) for name, make in MAKERS.items()}


@pytest.mark.parametrize("name", MAKERS)
def test_learns_two_moons(name, fitted, moons):
    probabilities = fitted[name].predict_proba(moons.X_test)
    np.testing.assert_allclose(probabilities.sum(axis=1), 1.0, atol=1e-6)
    assert (probabilities.argmax(axis=1) == moons.y_test).mean() > 0.97


@pytest.mark.parametrize("name", MAKERS)
def test_the_seed_decides_the_fit(name, fitted, moons):
    again = MAKERS[name]().fit(moons.X, moons.y, np.random.default_rng(1))
    np.testing.assert_allclose(again.uncertainty(moons.X), fitted[name].uncertainty(moons.X), atol=1e-6)


@pytest.mark.parametrize("name", MAKERS)
def test_uncertainty_lies_between_0_and_1(name, fitted, moons):
    uncertainty = fitted[name].uncertainty(np.concatenate([moons.X, moons.X_ood, [[50.0, 50.0]]]))
    assert uncertainty.min() >= 0.0
    assert uncertainty.max() <= 1.0 + 1e-9


def test_gp_variance_grows_away_from_the_data(fitted):
    ray = np.column_stack([np.linspace(1.0, 12.0, 40), np.zeros(40)])
    ray = ray[ray[:, 0] > 2.2]  # the moons end at x = 2.1
    uncertainty = fitted["gp"].uncertainty(ray)
    assert (np.diff(uncertainty) >= -1e-9).all()
    assert uncertainty[-1] == pytest.approx(1.0, abs=1e-6)
    assert fitted["gp"].predict_proba(ray[-1:])[0, 0] == pytest.approx(0.5, abs=1e-6)


def test_gp_matches_the_dense_formula(moons):
    config = GaussianProcessConfig(length_scale=0.7, signal=2.0)
    gp = GaussianProcess(config).fit(moons.X[::10], moons.y[::10], np.random.default_rng(0))
    query = moons.X_test[:5]

    def kernel(A, B):
        return 4.0 * np.exp(-((A[:, None] - B) ** 2).sum(axis=2) / (2.0 * 0.7**2))

    target, noise = gp._observations(moons.y[::10], 2)
    for column in range(2):
        inverse = np.linalg.inv(kernel(gp.X, gp.X) + np.diag(noise[:, column]))
        cross = kernel(query, gp.X)
        mean, variance = (values[:, column] for values in gp.latent(query))
        np.testing.assert_allclose(mean, cross @ inverse @ target[:, column], rtol=1e-6)
        np.testing.assert_allclose(variance, 4.0 - np.einsum("ij,jk,ik->i", cross, inverse, cross), rtol=1e-6)


def test_gp_finds_longer_length_scales_for_smoother_labels():
    found = []
    for length in (0.3, 1.0, 3.0):
        rng = np.random.default_rng(4)
        X = rng.uniform(-4.0, 4.0, (200, 1))
        K = np.exp(-((X - X.T) ** 2) / (2.0 * length**2))
        latent = np.linalg.cholesky(K + 1e-6 * np.eye(200)) @ rng.normal(size=200)
        found.append(GaussianProcess().fit(X, (latent > np.median(latent)).astype(int), rng).length_scale)
    assert found[0] < found[1] < found[2]


def test_dropout_is_active_at_prediction(fitted, moons):
    passes = fitted["mc_dropout"].predict_passes(moons.X_test)
    assert passes.shape == (8, 400, 2)
    assert passes.std(axis=0).max() > 0.01
    assert len(np.unique(passes[:, 0, 0])) == 8
    np.testing.assert_array_equal(passes, fitted["mc_dropout"].predict_passes(moons.X_test))


def test_ensemble_members_differ_on_what_they_have_not_seen(fitted, moons):
    members = fitted["deep_ensemble"].predict_members(moons.X_test)
    assert members.shape == (3, 400, 2)
    assert (members.argmax(axis=2) == moons.y_test).mean(axis=1).min() > 0.95
    assert np.abs(members[0] - members[1]).max() > 0.01
    weights = [network.residual[0].weight for network in fitted["deep_ensemble"].networks]
    assert not torch.equal(weights[0], weights[1])


def largest_norm(model: DnnGp) -> float:
    return max(float(torch.linalg.matrix_norm(layer.weight.detach(), 2)) for layer in model.network.residual)


def test_spectral_norms_are_bounded_for_sngp_only(fitted):
    assert largest_norm(fitted["sngp"]) <= fitted["sngp"].norm_bound * 1.01
    assert largest_norm(fitted["dnn_gp"]) > 1.0


def test_sngp_keeps_distances_within_the_bound(fitted, moons):
    # Each residual layer stretches by at most 1 + bound.
    sngp = fitted["sngp"]
    points = torch.as_tensor(moons.X_test[:100], dtype=torch.float32)
    with torch.no_grad():
        inputs, hidden = (
            torch.cdist(sngp.network.input(points), sngp.network.input(points)),
            sngp.network.hidden(points),
        )
    stretch = torch.cdist(hidden, hidden) / inputs.clamp_min(1e-9)
    off_diagonal = stretch[~torch.eye(100, dtype=torch.bool)]
    assert off_diagonal.max() <= (1.0 + 0.9 * 1.01) ** NETWORK.layers


@pytest.mark.parametrize("name", ["dnn_gp", "sngp"])
def test_gaussian_layer_variance_is_lowest_on_the_data(name, fitted, moons):
    on_data = fitted[name].logits(moons.X_test)[1]
    away = fitted[name].logits(moons.X_ood + np.array([3.0, -3.0]))[1]
    assert np.median(away) > 2.0 * np.median(on_data)


def test_gini_is_one_for_even_and_zero_for_sure():
    np.testing.assert_allclose(gini(np.array([[0.25] * 4, [1.0, 0.0, 0.0, 0.0]])), [1.0, 0.0])
    p = np.array([[0.3, 0.7]])
    np.testing.assert_allclose(gini(p), 4 * 0.3 * 0.7)


@pytest.mark.parametrize("name", MAKERS)
def test_wrong_input_is_refused(name, moons):
    rng = np.random.default_rng(0)
    for X, y in [
        (moons.X, moons.y[:-1]),
        (moons.X, moons.y.astype(float)),
        (moons.X * np.nan, moons.y),
        (moons.X, np.zeros_like(moons.y)),
        (moons.X, moons.y - 1),
    ]:
        with pytest.raises(DataError):
            MAKERS[name]().fit(X, y, rng)


HINGES = np.stack(np.meshgrid(np.arange(-3.25, 3.5, 0.5), np.arange(-2.25, 2.5, 0.5)), -1).reshape(-1, 2)


def test_bayesian_hilbert_learns_and_doubts_what_is_far(moons):
    config = BayesianHilbertConfig(gamma=4.0, batch=150, prior_precision=0.01)
    model = BayesianHilbertMap(config).fit(moons.X, moons.y, HINGES, np.random.default_rng(0))
    assert (model.predict_proba(moons.X_test).argmax(axis=1) == moons.y_test).mean() > 0.97
    _, seen = model.latent(moons.X_test)
    _, unseen = model.latent(np.array([[-2.25, -1.75], [-2.75, 1.75]]))  # hinge points without data
    assert unseen.min() > 10.0 * np.median(seen)
    np.testing.assert_allclose(model.predict_proba(np.array([[90.0, 90.0]])), 0.5, atol=1e-6)


def test_bayesian_hilbert_is_the_posterior_of_the_bound(moons):
    # One batch, one round: xi = 1, so the posterior is a ridge regression known in closed form.
    config = BayesianHilbertConfig(gamma=4.0, iterations=1, prior_precision=0.5, rows=64)
    model = BayesianHilbertMap(config).fit(moons.X, moons.y, HINGES, np.random.default_rng(0))
    phi = np.exp(-4.0 * ((moons.X[:, None] - HINGES) ** 2).sum(axis=2))
    curvature = 1.0 / (1.0 + np.exp(-1.0)) - 0.5
    precision = 0.5 * np.eye(len(HINGES)) + curvature * phi.T @ phi
    mean = np.linalg.solve(precision, phi.T @ (moons.y - 0.5))
    np.testing.assert_allclose(model.mu, mean, atol=1e-3)
    query = np.exp(-4.0 * ((moons.X_test[:20, None] - HINGES) ** 2).sum(axis=2))
    variance = np.einsum("ij,ji->i", query, np.linalg.solve(precision, query.T))
    np.testing.assert_allclose(model.latent(moons.X_test[:20])[1], variance, rtol=1e-3)


def test_bayesian_hilbert_variance_falls_with_every_batch(moons):
    config = BayesianHilbertConfig(gamma=4.0, batch=100)
    traces: list[float] = []
    model = BayesianHilbertMap(config)
    model.fit(
        moons.X,
        moons.y,
        HINGES,
        np.random.default_rng(0),
        progress=lambda done, total: traces.append(float(model.latent(moons.X)[1].mean())),
    )
    assert len(traces) == 4
    assert (np.diff(traces) < 0).all()


def test_bayesian_hilbert_weight_counts_repeated_observations(moons):
    X, y = moons.X[::6], moons.y[::6]
    repeats = np.random.default_rng(3).integers(1, 4, len(X))
    fits = [
        BayesianHilbertMap(BayesianHilbertConfig(gamma=4.0)).fit(
            *data, HINGES, np.random.default_rng(0), **weights
        )
        for data, weights in [
            ((X, y), {"weights": repeats}),
            ((np.repeat(X, repeats, axis=0), np.repeat(y, repeats)), {}),
        ]
    ]
    np.testing.assert_allclose(*(fit.latent(moons.X_test)[0] for fit in fits), rtol=1e-2, atol=1e-2)
    with pytest.raises(DataError, match="weights"):
        BayesianHilbertMap().fit(X, y, HINGES, np.random.default_rng(0), weights=np.zeros(len(X)))


def test_bayesian_hilbert_is_binary(moons):
    with pytest.raises(DataError, match="binary"):
        BayesianHilbertMap().fit(moons.X[:3], np.array([0, 1, 2]), HINGES, np.random.default_rng(0))


def test_hilbert_map_has_no_uncertain_class(moons):
    model = HilbertMap(MapConfig(gamma=4.0)).fit(moons.X, moons.y, hinges=HINGES)
    probabilities = model.predict_proba(moons.X_test)
    assert probabilities.shape == (400, 2)
    assert (probabilities.argmax(axis=1) == moons.y_test).mean() > 0.97
    np.testing.assert_allclose(model.predict_proba(np.array([[90.0, 90.0]])), 0.5, atol=1e-6)


def noisy_moons(moons: ToySet) -> tuple[np.ndarray, np.ndarray]:
    noise = np.random.default_rng(2).uniform(moons.low, moons.high, (400, 2))
    return np.concatenate([moons.X, noise]), np.concatenate([moons.y, np.full(400, 2)])


@pytest.mark.parametrize("layers", [0, 1, 2])
def test_deep_map_learns_moons_and_noise(layers, moons):
    X, y = noisy_moons(moons)
    config = DeepMapConfig(gamma=4.0, hidden_layers=layers, epochs=40, batch=128)
    model = DeepMap(config).fit(X, y, HINGES, np.random.default_rng(0))
    probabilities = model.predict_proba(moons.X_test)
    assert (probabilities[:, :2].argmax(axis=1) == moons.y_test).mean() > 0.97
    assert model.predict_proba(moons.X_ood)[:, 2].mean() > probabilities[:, 2].mean() + 0.5
    axes = (np.linspace(-3, 3, 7), np.linspace(-2, 2, 5))
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    np.testing.assert_allclose(
        model.predict_lattice(axes).reshape(-1, 3), model.predict_proba(lattice.reshape(-1, 2)), atol=1e-4
    )


def test_deep_map_without_hidden_layers_is_contramap(moons):
    X, y = noisy_moons(moons)
    deep_config = DeepMapConfig(gamma=4.0, hidden_layers=0, epochs=60, batch=128, learning_rate=0.3)
    deep = DeepMap(deep_config).fit(X, y, HINGES, np.random.default_rng(0)).predict_proba(X)
    convex = ContraMap(MapConfig(gamma=4.0, l2=1e-5)).fit(X, y, hinges=HINGES).predict_proba(X)
    losses = [-np.log(p[np.arange(len(y)), y]).mean() for p in (deep, convex)]
    assert losses[0] == pytest.approx(losses[1], rel=0.1)


def test_deep_map_refuses_what_does_not_fit(moons):
    with pytest.raises(ConfigError):
        DeepMap(DeepMapConfig(hidden_layers=-1))
    with pytest.raises(DataError):
        DeepMap().fit(moons.X, moons.y[:-1], HINGES, np.random.default_rng(0))
