"""Fits in local steps: bounds that are no less than the curvature, losses that fall, nothing shared."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import torch
from scipy.special import softmax
from test_multiscale import dense, street

from mapping.hashed_hinges import HashedHinges, filled_nodes, hinges_at
from mapping.hashed_tiles import features_in_tiles
from mapping.last_class import LastClass
from mapping.local_steps import fit_locally
from mapping.objectives import TiledObjective
from mapping.threads import Threads

OFFSET = np.array([0.2, 0.0, -0.3], np.float32)


@pytest.fixture
def threads() -> Iterator[Threads]:
    with Threads() as found:
        yield found


def hinges_of(X: np.ndarray) -> HashedHinges:
    spacings = np.array([(0.5, 0.5, 0.5), (1.0, 1.0, 3.0)])
    return hinges_at([filled_nodes(X, one) for one in spacings], spacings, np.array([0.4, 1.0]), 1.5, 1e-2)


def classes_of(
    X: np.ndarray, y: np.ndarray, hinges: HashedHinges, l2: float, threads: Threads
) -> TiledObjective:
    """The classes' objective, every sample of weight 1/100."""
    features = features_in_tiles(X, hinges)
    weights = torch.full((len(X),), 0.01)
    targets = torch.eye(3)[torch.from_numpy(y[features.order])] * weights[:, None]
    return TiledObjective(features, targets, weights, torch.from_numpy(OFFSET), l2, threads)


def test_the_bound_is_no_less_than_the_curvature(threads):
    X, y = street(40)
    hinges, rng = hinges_of(X), np.random.default_rng(0)
    features = features_in_tiles(X, hinges)
    phi, H = dense(features), features.hinge_count
    for size in (0.0, 1.0, 8.0):
        W = (size * rng.normal(size=(H, 3))).astype(np.float32)
        bound = classes_of(X, y, hinges, 1e-3, threads).bound_at(torch.from_numpy(W)).numpy()
        p = softmax(phi @ W + OFFSET, axis=1)
        hessian = np.zeros((H, 3, H, 3))
        for c in range(3):
            for d in range(3):
                share = 0.01 * p[:, c] * ((c == d) - p[:, d])
                hessian[:, c, :, d] = (phi * share[:, None]).T @ phi
        left = np.diag(bound.reshape(-1)) - hessian.reshape(3 * H, 3 * H)
        assert np.linalg.eigvalsh(left).min() > 0
        weights = np.full(len(X), 0.01, np.float32)
        last = LastClass([features], [0 * weights], [weights], W[:, :2], OFFSET, 1e-3, threads)
        given = phi @ W + OFFSET
        p = 1 / (1 + np.exp(np.logaddexp(given[:, 0], given[:, 1]) - given[:, 2]))
        left = np.diag(last.bound_at(torch.from_numpy(W[:, 2:].copy())).numpy()[:, 0])
        assert np.linalg.eigvalsh(left - (phi * (0.01 * p * (1 - p))[:, None]).T @ phi).min() > 0


def test_local_steps_go_to_the_minimum(threads):
    X, y = street(150)
    objective = classes_of(X, y, hinges_of(X), 1e-3, threads)
    W, report = fit_locally(objective, 400, None)
    assert report.iterations == 400
    loss, slope = objective.at(W)
    assert loss < 0.2 * report.losses[0]
    assert slope.abs().max() < 1e-4
    again, _ = fit_locally(objective, 20, W)  # goes on where it is told to
    assert objective.at(again)[0] < loss + 1e-5


def test_what_is_far_away_changes_nothing(threads):
    X, y = street(150)
    both = np.concatenate([X, X + np.array([60.0, 0, 0])])
    hinges, weights = hinges_of(both), []
    for other in (y, (y + 1) % 3):
        objective = classes_of(both, np.append(y, other), hinges, 1e-3, threads)
        weights.append(fit_locally(objective, 60, None)[0].numpy())
    near = np.concatenate([hinges.nodes[: hinges.first[1]] * 0.5, hinges.nodes[hinges.first[1] :]])[:, 0] < 30
    one, other = (found[near] for found in weights)
    assert near.sum() > 100
    np.testing.assert_allclose(one, other, atol=1e-5)
