"""Maps of many points with kernels of several widths: dense sums, label noise, far away, bad input."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from scipy.special import softmax

from mapping.cell_noise import cells_around, noise_in
from mapping.errors import ConfigError, DataError
from mapping.hashed_hinges import filled_nodes, hinges_at
from mapping.hashed_tiles import features_in_tiles, shares_at
from mapping.kernels import blocks, dense_features
from mapping.label_doubt import label_doubt, labels_of
from mapping.label_noise import disagreement, true_labels, wrong_label_share
from mapping.last_class import LastClass
from mapping.multiscale import MultiscaleConfig, MultiscaleMap, Whole
from mapping.threads import Threads
from mapping.tiled_features import TiledFeatures

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
    assert np.median(uncertain) < 0.9
    rng = np.random.default_rng(0)
    sky = np.column_stack([rng.uniform(0, 12, 2000), rng.uniform(-4, 4, 2000), rng.uniform(6, 20, 2000)])
    assert fitted.predict_known(sky)[1].min() > 0.9  # everywhere, also right over posts and walls


def test_noise_does_not_bend_the_borders_of_classes(fitted):
    X, y = street(3000)
    alone = MultiscaleMap(uncertain=False).fit(X, y, 3, np.random.default_rng(1))
    asked = street(800, seed=1)[0] + RNG.normal(0, 0.3, (1640, 3))
    np.testing.assert_allclose(fitted.predict_known(asked)[0], alone.predict_proba(asked), atol=1e-4)
    np.testing.assert_array_equal(fitted.W[:, :-1], alone.W)


def test_the_last_class_has_the_loss_and_the_curvature_of_a_softmax():
    X, _ = street(60)
    spacings = np.array([(0.5, 0.5, 0.5), (1.0, 1.0, 3.0)])
    hinges = hinges_at([filled_nodes(X, s) for s in spacings], spacings, np.ones(2), 1.5, 1e-2)
    asked = [X, X[:21] + np.array([0.0, 0.0, 0.8])]
    kinds = [features_in_tiles(part, hinges) for part in asked]
    H, C, offset = len(hinges.nodes), 3, np.array([0.1, 0.0, -0.2, 1.3], np.float32)
    W = RNG.normal(size=(H, C + 1)).astype(np.float32)
    targets = [RNG.random(len(part)).astype(np.float32) for part in asked]
    weights = [RNG.random(len(part)).astype(np.float32) for part in asked]
    with Threads() as threads:
        last = LastClass(kinds, targets, weights, W[:, :C], offset, 0.1, threads)
        u = torch.from_numpy(W[:, C:].copy())
        loss, slope = last.at(u)
        curvature = last.curvature_at(u).numpy()[:, 0]
    want, dense_slope, dense_curvature = 0.05 * (W[:, C] ** 2).sum(), 0.1 * W[:, C], np.full(H, 0.1)
    for kind, target, weight in zip(kinds, targets, weights):  # rows as in the tiles
        phi = dense(kind)
        p = softmax(phi @ W + offset, axis=1)[:, C]
        want += -(weight * (target * np.log(p) + (1 - target) * np.log(1 - p))).sum()
        dense_slope = dense_slope + phi.T @ (weight * (p - target))
        dense_curvature += (phi**2).T @ (weight * p * (1 - p))
    assert loss == pytest.approx(want, rel=1e-4)
    np.testing.assert_allclose(slope.numpy()[:, 0], dense_slope, atol=1e-3)
    np.testing.assert_allclose(curvature, dense_curvature, atol=1e-3)


def dense(tiled: TiledFeatures) -> np.ndarray:
    """Features (N, H) of rows in their own order."""
    found, first = np.zeros((len(tiled.order), tiled.hinge_count)), 0
    for share in tiled.shares:
        for t, (start, stop) in enumerate(pairwise(share.starts)):
            rows = np.arange(first + 8 * t, min(first + 8 * t + 8, len(found)))
            values = share.values.reshape(-1, 8)[start:stop, : len(rows)]
            np.add.at(found, (rows, share.columns[start:stop, None]), values)  # some are split among columns
        first += 8 * (len(share.starts) - 1)
    return found


def test_hashed_features_are_the_dense_ones():
    X, _ = street(300)
    X = X + np.array([5000.0, -300.0, 20.0])  # as far away as a city's other end
    spacings, amplitude = np.array([(0.2, 0.2, 0.2), (0.3, 0.4, 2.0)]), np.array([0.5, 1.0])
    hinges = hinges_at([filled_nodes(X, spacing) for spacing in spacings], spacings, amplitude, 1.5, 3e-3)
    asked = X + RNG.normal(0, 0.2, X.shape)  # also where no hinge point is at the nearest node
    phi = np.zeros((len(asked), len(hinges.nodes)))
    for t, spacing in enumerate(spacings):
        own = slice(hinges.first[t], hinges.first[t + 1])
        gap = asked[:, None] / spacing - hinges.nodes[own]
        phi[:, own] = np.exp(-1.5 * (gap**2).sum(2))
    phi[np.abs(phi - 3e-3) < 1e-6] = 0  # on the edge of reach
    phi[phi <= 3e-3] = 0
    tiled, found, strongest = features_in_tiles(asked, hinges), np.empty_like(phi), np.empty(len(asked))
    found[tiled.order] = dense(tiled)
    strongest[tiled.order] = tiled.strongest
    loud = np.repeat(amplitude, np.diff(hinges.first))
    np.testing.assert_allclose(found, phi * loud, atol=4e-3 * loud.max())
    assert np.median(np.abs(found - phi * loud)[phi > 0]) < 1e-5
    np.testing.assert_allclose(strongest, phi.max(1), atol=4e-3)
    W = RNG.normal(size=(phi.shape[1], 4)).astype(np.float32)
    offset = np.arange(4, dtype=np.float32)
    want = np.zeros((len(asked), 6))
    want[:, [5, 0, 2, 3]] = softmax(found @ W + offset, axis=1)
    got = shares_at(asked, hinges, W, offset, np.array([5, 0, 2, 3]), 6)
    np.testing.assert_allclose(got, want, atol=1e-5)


def test_an_answer_does_not_depend_on_what_else_is_asked(fitted):
    X = np.concatenate([street(4000, seed=4)[0], RNG.uniform(-3000, 3000, (500, 3)), [[1e12, 0, -1e9]]])
    order = RNG.permutation(len(X))
    every = fitted.predict_proba(X[order])
    np.testing.assert_allclose(every[np.argsort(order)], fitted.predict_proba(X), atol=1e-5)
    some = order[:40]  # too few to share hinge points
    alone = np.concatenate([fitted.predict_proba(X[i : i + 1]) for i in some])
    np.testing.assert_allclose(alone, every[:40], atol=1e-5)
    assert fitted.predict_proba(X[:0]).shape == (0, 4)


def test_doubt_is_the_lead_that_a_label_lacks(fitted):
    shares = np.array([[0.5, 0.5, 0.0], [1.0, 0.0, 0.0], [0.2, 0.1, 0.7]], np.float32)
    np.testing.assert_allclose(label_doubt(shares), [1.0, 0.0, 0.5], atol=1e-6)
    np.testing.assert_array_equal(label_doubt(np.ones((2, 1), np.float32)), 0)
    X, _ = street(800, seed=1)
    known, uncertain = fitted.predict_known(X)
    for answer in (fitted.predict_labels(X), labels_of(fitted.predict_proba(X))):
        np.testing.assert_array_equal(answer.label, known.argmax(1))
        np.testing.assert_allclose(answer.doubt, label_doubt(known), atol=1e-5)
        np.testing.assert_allclose(answer.uncertain, uncertain, atol=1e-6)
    edge = fitted.predict_labels(np.array([[3.0, 3.9, 0.05], [3.0, 0.0, 0.0]]))
    assert edge.doubt[0] > edge.doubt[1]  # where wall and floor meet
    assert len(fitted.predict_labels(X[:0]).doubt) == 0


def test_a_part_fitted_alone_is_the_whole_in_its_middle():
    X, y = street(400)
    X, y = np.concatenate([X, X[y == 2] + [40.0, 0, 0]]), np.append(y, np.full((y == 2).sum(), 3))
    config = replace(MultiscaleConfig(), local_steps=40)  # far from the minimum
    whole = Whole.of(X, y, 4, config)
    part = X[:, 0] < 10  # without class 3, and without the place where cells could be counted from
    asked = X[X[:, 0] < 3][::5] + np.random.default_rng(0).normal(0, 0.1, (1, 3))
    answers = [
        MultiscaleMap(config).fit(X[own], y[own], 4, np.random.default_rng(0), whole).predict_proba(asked)
        for own in (np.full(len(X), True), part)
    ]
    assert np.abs(answers[0] - answers[1]).max() < 1e-3


def test_lattice_and_points_agree(fitted):
    axes = (np.array([3.0, 6.0]), np.array([0.0, 3.9]), np.array([0.0, 1.0, 2.0]))
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    lattice = fitted.predict_lattice(axes).reshape(-1, 4)
    np.testing.assert_allclose(lattice, fitted.predict_proba(points), atol=1e-5)


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
    np.testing.assert_array_equal(loaded.predict_proba(asked), fitted.predict_proba(asked))
    np.savez(tmp_path / "other.npz", W=np.zeros(3))
    with pytest.raises(DataError, match="format"):
        MultiscaleMap().load(tmp_path / "other.npz")


def test_noise_lies_around_the_points():
    X, _ = street(200)
    cell = np.array([2.0, 2.0, 0.67])
    noise = noise_in(cells_around(X, cell), cell, 1.7, 3)
    assert len(noise) == pytest.approx(1.7 * len(cells_around(X, cell)), rel=0.1)
    again = noise_in(cells_around(X[X[:, 0] < 6], cell), cell, 1.7, 3)  # a part has the same ones
    assert len(again) > 20
    assert np.isin(again, noise).all()
    assert np.abs(np.corrcoef(np.mod(noise / cell + 0.5, 1).T) - np.eye(3)).max() < 0.15
    gap = (np.abs(noise[:, None] - X) / cell).max(2).min(1)
    assert gap.max() <= 2 + 1e-5
    assert gap.max() > 1


def test_a_class_without_samples_is_never_the_answer():
    X, y = street(500)
    model = MultiscaleMap().fit(X, 2 * y, 6, np.random.default_rng(1))
    proba = model.predict_proba(X[::20])
    assert proba.shape[1] == 7
    assert proba[:, [1, 3, 5]].max() < 1e-6
    assert (proba[:, :-1].argmax(1) == 2 * y[::20]).mean() > 0.95


def test_true_labels_follow_bayes():
    shares = np.array([[0.9, 0.1], [0.5, 0.5]], np.float32)
    mended = true_labels(np.array([1, 0]), shares, 0.2)
    np.testing.assert_allclose(mended, [[0.9 * 0.2 / 0.26, 0.1 * 0.8 / 0.26], [0.8, 0.2]], rtol=1e-5)


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
    with pytest.raises(ConfigError, match="as many, one"):
        MultiscaleMap(replace(MultiscaleConfig(), amplitudes=(1.0,)))
    with pytest.raises(ConfigError, match="three lengths"):
        MultiscaleMap(replace(MultiscaleConfig(), spacings=((0.1, 0.1),), amplitudes=(1.0,)))
    with pytest.raises(ConfigError, match="as many, one"):
        MultiscaleMap(replace(MultiscaleConfig(), far_around=()))
    with pytest.raises(DataError, match=r"\(N, 3\)"):
        MultiscaleMap().fit(np.zeros((4, 2)), np.zeros(4, int), 2, RNG)
    with pytest.raises(DataError, match="as many labels"):
        MultiscaleMap().fit(np.zeros((4, 3)), np.zeros(3, int), 2, RNG)
    with pytest.raises(DataError, match="not fitted"):
        MultiscaleMap().predict_known(np.zeros((1, 3)))
