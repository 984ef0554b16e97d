"""The map itself: probabilities, evaluation paths, optimality, far behaviour, files and bad input."""

import numpy as np
import pytest
import torch
from blobs import CLASSES, blobs
from sklearn.linear_model import LogisticRegression

from mapping import ConfigError, ContraMap, DataError, MapConfig, load_map
from mapping.config import FitConfig
from mapping.kernels import dense_features


@pytest.fixture(scope="module", params=[2, 3])
def data(request):
    return blobs(request.param)


@pytest.fixture(scope="module")
def fitted(data):
    X, y, hinges = data
    rng = np.random.default_rng(0)
    # Two widths and points off the lattice, so that every evaluation path is walked.
    scattered = rng.uniform(-0.2, 0.2, (7, X.shape[1])).astype(np.float32)
    gamma = np.repeat([300.0, 900.0], [len(hinges), len(scattered)])
    return ContraMap(MapConfig()).fit(X, y, hinges=np.concatenate([hinges, scattered]), gamma=gamma)


def test_probabilities_sum_to_one(fitted):
    X = np.random.default_rng(1).uniform(-0.5, 0.5, (500, fitted.hinges.shape[1]))
    p = fitted.predict_proba(X)
    assert p.shape == (500, CLASSES)
    assert p.min() >= 0
    np.testing.assert_allclose(p.sum(1), 1, atol=1e-5)


def test_point_dense_and_lattice_evaluation_agree(fitted):
    dimensions = fitted.hinges.shape[1]
    axes = tuple(np.linspace(-0.3, 0.25 + 0.01 * i, 37 + i).astype(np.float32) for i in range(dimensions))
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, dimensions)
    at_points = fitted.predict_proba(points)
    dense = dense_features(*(torch.from_numpy(a) for a in (points, fitted.hinges, fitted.gamma))) @ fitted.W
    np.testing.assert_allclose(at_points, torch.softmax(dense + fitted.offset, 1).numpy(), atol=1e-4)
    np.testing.assert_allclose(at_points, fitted.predict_lattice(axes).reshape(-1, CLASSES), atol=1e-4)


def test_logits_beyond_the_range_of_exponentials_are_fitted_all_the_same(data):
    X, y, hinges = data
    config = MapConfig(gamma=300.0, far_uncertainty=None, empty_log_odds=120.0)  # exp(120) is no float32
    fitted = ContraMap(config).fit(X, y, hinges=hinges)
    offset = fitted.offset.double()
    start = float((torch.logsumexp(offset, 0) - offset)[torch.from_numpy(y)].mean())
    assert fitted.report.losses[0] == pytest.approx(start, rel=1e-5)
    assert np.isfinite(fitted.report.losses).all()
    assert fitted.report.losses[-1] < start / 4


def test_a_lattice_larger_than_a_block_agrees_with_points():
    rng = np.random.default_rng(0)
    hinges = np.stack(np.meshgrid(np.arange(20.0), np.arange(9.0), indexing="ij"), -1).reshape(-1, 2)
    X = rng.uniform(-1, [20, 9], (3000, 2))
    fitted = ContraMap(MapConfig(gamma=1.5)).fit(X, (X[:, 0] > 10).astype(int), hinges=hinges, classes=3)
    axes = (np.linspace(-3, 22, 400), np.linspace(-2, 10, 50))
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
    expected = fitted.predict_proba(points).reshape(400, 50, 3)
    np.testing.assert_allclose(fitted.predict_lattice(axes), expected, atol=2e-5)


@pytest.mark.parametrize("l2", [1e-2, 1e-4])
def test_loss_is_within_1e3_of_scikit_learn(data, l2):
    X, y, hinges = data
    config = MapConfig(gamma=300.0, l2=l2, far_uncertainty=None)
    ours = ContraMap(config).fit(X, y, hinges=hinges)
    phi = np.exp(-300.0 * ((X[:, None].astype(float) - hinges[None]) ** 2).sum(2))
    reference = LogisticRegression(C=1 / (l2 * len(X)), fit_intercept=False, tol=1e-8, max_iter=5000)
    reference.fit(phi, y)

    def loss(W):
        logits = phi @ W
        logits -= logits.max(1, keepdims=True)
        log_p = logits - np.log(np.exp(logits).sum(1, keepdims=True))
        return -log_p[np.arange(len(y)), y].mean() + 0.5 * l2 * (W**2).sum()

    best = loss(reference.coef_.T)
    assert loss(ours.W.numpy().astype(float)) - best < 1e-3
    assert abs(ours.report.losses[-1] - best) < 1e-3
    assert ours.report.converged


def test_the_fit_gets_near_the_optimum_in_few_steps(data):
    X, y, hinges = data
    quick = ContraMap(MapConfig(gamma=300.0)).fit(X, y, hinges=hinges)
    patient_fit = FitConfig(tolerance=1e-8, max_iterations=3000)
    patient = ContraMap(MapConfig(gamma=300.0, fit=patient_fit)).fit(X, y, hinges=hinges)
    assert quick.report.losses[-1] - patient.report.losses[-1] < 5e-3
    assert quick.report.iterations < 100
    renewed_fit = FitConfig(tolerance=1e-8, max_iterations=3000, renew=5)
    renewed = ContraMap(MapConfig(gamma=300.0, fit=renewed_fit)).fit(X, y, hinges=hinges)
    assert renewed.report.losses[-1] == pytest.approx(patient.report.losses[-1], abs=1e-5)


def test_a_fit_from_earlier_weights_stops_sooner(data):
    X, y, hinges = data
    first = ContraMap(MapConfig(gamma=300.0)).fit(X[:-20], y[:-20], hinges=hinges, classes=y.max() + 1)
    start, steps = first.W.numpy(), []
    for warm in (1.0, 4.0):
        config = MapConfig(gamma=300.0, fit=FitConfig(warm=warm))
        cold = ContraMap(config).fit(X, y, hinges=hinges)
        again = ContraMap(config).fit(X, y, hinges=hinges, start=start)
        assert again.report.losses[-1] < cold.report.losses[-1] + 2e-3
        steps += [cold.report.iterations, again.report.iterations]
    assert steps[0] == steps[2]  # it has no say where there is nothing to begin with
    assert steps[3] < steps[1] < steps[0]


@pytest.mark.parametrize("share", [0.9, 0.95, 0.99])
def test_out_of_reach_is_uncertain_whatever_the_class_balance(data, share):
    X, y, hinges = data
    kept = (y != 3) | (np.arange(len(y)) % 20 == 0)  # hardly any noise
    model = ContraMap(MapConfig(far_uncertainty=share, empty_log_odds=2.0)).fit(
        X[kept], y[kept], hinges=hinges, classes=CLASSES
    )
    far = np.full((1, X.shape[1]), 7.0)
    np.testing.assert_allclose(model.predict_proba(far)[0, -1], share, atol=1e-5)


def test_permuting_classes_permutes_columns(data):
    X, y, hinges = data
    order = np.array([2, 0, 1, 3])  # the uncertain class stays last
    p = ContraMap().fit(X, y, hinges=hinges).predict_proba(X)
    q = ContraMap().fit(X, order[y], hinges=hinges).predict_proba(X)
    # The fit stops near the optimum; rounding decides where exactly.
    np.testing.assert_allclose(q[:, order], p, atol=2e-2)


def test_soft_labels_equal_to_hard_ones_give_the_same_map(data):
    X, y, hinges = data
    hard = ContraMap().fit(X, y, hinges=hinges)
    soft = ContraMap().fit(X, np.eye(CLASSES)[y], hinges=hinges)
    np.testing.assert_array_equal(hard.W.numpy(), soft.W.numpy())


def test_weights_count_like_repeated_samples(data):
    X, y, hinges = data
    weights = np.where(y == 0, 2.0, 1.0)
    weighted = ContraMap().fit(X, y, hinges=hinges, weights=weights)
    repeated = ContraMap().fit(np.concatenate([X, X[y == 0]]), np.concatenate([y, y[y == 0]]), hinges=hinges)
    assert abs(weighted.report.losses[-1] - repeated.report.losses[-1]) < 1e-3


def test_occupancy_gradient_matches_differences(fitted):
    rng = np.random.default_rng(2)
    X = rng.uniform(-0.15, 0.15, (40, fitted.hinges.shape[1]))
    _, _, gradient = fitted.predict_occupancy(X)
    step = 5e-4
    for axis in range(X.shape[1]):
        shift = np.zeros(X.shape[1])
        shift[axis] = step
        ahead, behind = fitted.predict_occupancy(X + shift)[1], fitted.predict_occupancy(X - shift)[1]
        np.testing.assert_allclose(
            gradient[:, axis], (ahead - behind) / (2 * step), atol=0.02 * np.abs(gradient).max()
        )
    assert np.abs(gradient).max() > 5


def test_save_and_load_give_the_same_answers(fitted, tmp_path):
    fitted.save(tmp_path / "map.npz")
    loaded = load_map(tmp_path / "map.npz")
    X = np.random.default_rng(1).uniform(-0.3, 0.3, (50, fitted.hinges.shape[1]))
    np.testing.assert_array_equal(loaded.predict_proba(X), fitted.predict_proba(X))
    assert loaded.config == fitted.config
    assert loaded.report.iterations == fitted.report.iterations


@pytest.mark.parametrize("content", [None, b"", b"PK\x03\x04 cut short", b"not a zip"])
def test_a_broken_map_file_is_named(tmp_path, content):
    path = tmp_path / "map.npz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(DataError, match=r"map\.npz"):
        load_map(path)


def test_a_pickle_in_a_map_file_is_refused(tmp_path):
    np.savez(tmp_path / "map.npz", config=np.array([{"a": 1}], dtype=object))
    with pytest.raises(DataError, match="not a readable"):
        load_map(tmp_path / "map.npz")


@pytest.mark.parametrize(
    ("X", "y", "keywords", "message"),
    [
        (np.zeros(4), np.zeros(4, int), {}, "shape"),
        (np.full((4, 3), np.nan), np.zeros(4, int), {}, "NaN"),
        (np.zeros((4, 3)), np.zeros(3, int), {}, "y must be"),
        (np.zeros((4, 3)), np.array([0, 1, 2, 5]), {"classes": 4}, "0..3"),
        (np.zeros((4, 3)), np.zeros(4, int), {"weights": np.zeros(4)}, "weights"),
        (np.zeros((4, 3)), np.zeros(4, int), {"hinges": np.zeros((5, 2))}, "coordinates"),
    ],
)
def test_wrong_arrays_are_refused(X, y, keywords, message):
    with pytest.raises(DataError, match=message):
        ContraMap().fit(X, y, **keywords)


@pytest.mark.parametrize(
    "settings", [{"gamma": 0.0}, {"far_uncertainty": 1.0}, {"device": "tpu"}, {"far_uncertainty": 0.0}]
)
def test_senseless_settings_are_refused(settings):
    with pytest.raises(ConfigError):
        ContraMap(MapConfig(**settings))


@pytest.mark.skipif(torch.cuda.is_available(), reason="a CUDA device is present")
def test_cuda_without_a_device_is_one_clear_line():
    with pytest.raises(ConfigError, match="no CUDA device"):
        ContraMap(MapConfig(device="cuda"))
