"""Features in tiles of eight, and the cross-entropy of a softmax of them, against torch in doubles."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy import sparse

from mapping.compact_order import compact_order
from mapping.compiled import compiled
from mapping.lanes import LANES, every, exponential, load, logarithm, lowest_bit, store
from mapping.objectives import objective_of
from mapping.sparse_features import sparse_features
from mapping.threads import Threads
from mapping.tiled_features import SHARED_FROM, TiledFeatures, tiled_features
from mapping.tiles import Tiles

CPU = torch.device("cpu")


def matrix(features: TiledFeatures) -> sparse.csr_matrix:
    """Tiles as one sparse matrix (N, H), rows in the features' own order."""
    parts = [rows_of(share, features.hinge_count) for share in features.shares]
    return sparse.vstack(parts).tocsr()[: len(features.order)]


def rows_of(tiles: Tiles, width: int) -> sparse.csr_matrix:
    count = len(tiles.starts) - 1
    of_tile = np.repeat(np.arange(count), np.diff(tiles.starts))
    rows = (of_tile[:, None] * LANES + np.arange(LANES)).ravel()
    return sparse.csr_matrix((tiles.values, (rows, np.repeat(tiles.columns, LANES))), (count * LANES, width))


def lattice(step: float, sides: tuple[int, ...]) -> np.ndarray:
    axes = [step * np.arange(side) for side in sides]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(sides)).astype(np.float32)


def cloud(count: int, dimensions: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.03, 0.2, (count, dimensions)).astype(np.float32)


@pytest.mark.parametrize("count", [1, 7, 8, 9, 1000])
def test_a_compact_order_has_every_point_once(count: int) -> None:
    X = np.round(cloud(count, 3), 2)  # many coincide
    assert sorted(compact_order(X, LANES).tolist()) == list(range(count))


def test_points_that_follow_each_other_in_a_compact_order_lie_in_small_boxes() -> None:
    X = cloud(8 * 512, 3)
    boxes = X[compact_order(X, LANES)].reshape(-1, LANES, 3)
    # 512 boxes that fill a cube have sides of an eighth of its own.
    assert np.median(np.ptp(boxes, 1).max(1)) < 1.5 / 8 * 0.23


@pytest.mark.parametrize("dimensions", [1, 2, 3])
@pytest.mark.parametrize("count", [5, 1003, LANES * SHARED_FROM + 11])
def test_tiles_hold_the_same_features_as_sparse_rows(dimensions: int, count: int) -> None:
    hinges = np.concatenate(
        [lattice(0.02, (8, 9, 5)[:dimensions]), lattice(0.013, (9, 7, 9)[:dimensions]) + 0.001]
    )
    gamma = np.where(np.arange(len(hinges)) < len(lattice(0.02, (8, 9, 5)[:dimensions])), 900, 4000)
    X, gamma = cloud(count, dimensions), gamma.astype(np.float32)
    tiled = tiled_features(X, hinges, gamma, 0.02)
    by_search = tiled_features(X, hinges + np.float32(1e-5) * cloud(len(hinges), dimensions), gamma, 0.02)
    for found, close in ((tiled, 1e-5), (by_search, 1e-3)):
        want = sparse_features(X, hinges, gamma, 0.02, CPU)
        ends = np.append(want.rows.offsets.numpy(), len(want.rows.values))
        rows = sparse.csr_matrix((want.rows.values, want.rows.columns, ends), (count, len(hinges)))
        want_dense, got = np.zeros((2, count, len(hinges)))
        want_dense[want.order.numpy()], got[found.order] = rows.toarray(), matrix(found).toarray()
        both = (want_dense > 0.0201) | (got > 0.0201)  # at the bound itself rounding decides
        assert np.abs(want_dense - got)[both].max(initial=0) < close
        strongest = np.zeros(count)
        strongest[found.order] = found.strongest
        assert np.abs(strongest - got.max(1)).max() < 1e-6


@pytest.mark.parametrize("classes", [2, 3, 8, 9, 12, 13, 20])
@pytest.mark.parametrize("count", [3, 200, LANES * SHARED_FROM + 3])
def test_cross_entropy_and_its_slopes_are_those_of_torch(classes: int, count: int) -> None:
    rng = np.random.default_rng(classes)
    hinges, X = lattice(0.03, (6, 6, 6)), cloud(count, 3)
    features = tiled_features(X, hinges, np.full(len(hinges), 900, np.float32), 0.02)
    targets = rng.dirichlet(np.full(classes, 0.3), count).astype(np.float32)
    weights = (rng.uniform(0.1, 1, count) / count).astype(np.float32)
    offset = rng.normal(size=classes).astype(np.float32)
    W = torch.tensor(3 * rng.normal(size=(len(hinges), classes)), dtype=torch.float32)
    with Threads() as threads:
        tensors = [torch.from_numpy(part) for part in (targets, weights, offset)]
        objective = objective_of(features, *tensors, 1e-3, threads)
        loss, slopes = objective.at(W)
        curvature, second = objective.curvature(), objective.curvature_at(W)
    exact = W.double().requires_grad_()
    rows = torch.from_numpy(matrix(features).toarray()).double()
    log_p = torch.log_softmax(rows @ exact + tensors[2].double(), 1)
    want = -(tensors[0].double() * tensors[1].double()[:, None] * log_p).sum() + 5e-4 * exact.square().sum()
    want.backward()
    assert loss == pytest.approx(want.item(), rel=1e-5)
    assert exact.grad is not None
    assert (slopes - exact.grad).abs().max() < 1e-5 * exact.grad.abs().max()
    p = log_p.detach().exp()
    seconds = rows.square().T @ (tensors[1].double()[:, None] * p * (1 - p)) + 1e-3
    assert (second - seconds).abs().max() < 1e-5 * seconds.max()
    squares = 0.25 * (rows.square() * tensors[1].double()[:, None]).sum(0) + 1e-3
    assert (curvature - squares).abs().max() < 1e-5 * squares.max()


def test_logits_far_apart_neither_overflow_nor_lose_the_loss() -> None:
    hinges = lattice(0.03, (4, 4, 4))
    features = tiled_features(cloud(50, 3), hinges, np.full(len(hinges), 900, np.float32), 0.02)
    targets, weights = torch.eye(3)[torch.arange(50) % 3], torch.full((50,), 0.02)
    W = torch.zeros(len(hinges), 3)
    W[:, 1] = 1e4
    with Threads() as threads:
        loss, slopes = objective_of(features, targets, weights, torch.zeros(3), 0.0, threads).at(W)
    logits = torch.from_numpy(matrix(features).toarray()).double() @ W.double()
    want = -(targets * torch.log_softmax(logits, 1)).sum() * 0.02
    assert loss == pytest.approx(want.item(), rel=1e-5)
    assert torch.isfinite(slopes).all()


def test_both_objectives_agree() -> None:
    hinges, X = lattice(0.03, (6, 6, 6)), cloud(300, 3)
    gamma, targets = np.full(len(hinges), 900, np.float32), torch.arange(300) % 4
    weights, offset = torch.full((300,), 1 / 300), torch.tensor([0.5, 0, 0, -1])
    W = torch.linspace(-1, 1, 4 * len(hinges)).reshape(-1, 4)
    found = []
    for features in (tiled_features(X, hinges, gamma, 0.02), sparse_features(X, hinges, gamma, 0.02, CPU)):
        order = torch.as_tensor(features.order)
        with Threads() as threads:
            objective = objective_of(features, targets[order], weights, offset, 1e-4, threads)
            found.append((*objective.at(W), objective.curvature(), objective.curvature_at(W)))
    (loss, slopes, curvature, second), (other_loss, other_slopes, other_curvature, other_second) = found
    torch.testing.assert_close(second, other_second, atol=1e-6, rtol=1e-4)
    assert loss == pytest.approx(other_loss, rel=1e-5)
    torch.testing.assert_close(slopes, other_slopes, atol=1e-6, rtol=1e-4)
    torch.testing.assert_close(curvature, other_curvature, atol=1e-6, rtol=1e-4)


def test_exponentials_and_logarithms_are_right_to_single_precision() -> None:
    @compiled
    def exponentials(a: np.ndarray) -> np.ndarray:
        out = np.empty_like(a)
        for k in range(0, len(a), LANES):
            store(out, k, exponential(load(a, k)))
        return out

    @compiled
    def constant(a: np.ndarray) -> np.ndarray:
        store(a, 0, every(np.float32(3)))
        return a

    @compiled
    def logarithms(a: np.ndarray) -> np.ndarray:
        out = np.empty_like(a)
        for k in range(0, len(a), LANES):
            store(out, k, logarithm(load(a, k)))
        return out

    a = np.linspace(-86.9, 88, 8000, dtype=np.float32)
    exact = np.exp(a.astype(np.float64))
    assert np.abs(exponentials(a) / exact - 1).max() < 3e-7
    assert np.abs(logarithms(exact.astype(np.float32)) - np.log(exact.astype(np.float32))).max() < 1e-5
    near_one = np.linspace(0.5, 2, 8000, dtype=np.float32)
    assert np.abs(logarithms(near_one) - np.log(near_one.astype(np.float64))).max() < 2e-7
    assert (exponentials(np.full(8, -np.inf, np.float32)) < 1e-37).all()
    assert (constant(np.zeros(8, np.float32)) == 3).all()


@compiled
def lowest_bits(numbers: np.ndarray) -> np.ndarray:
    out = np.empty(len(numbers), np.int64)
    for i in range(len(numbers)):
        out[i] = lowest_bit(numbers[i])
    return out


def test_the_lowest_bit_of_any_number() -> None:
    places = np.arange(64)
    alone = np.uint64(1) << places.astype(np.uint64)
    np.testing.assert_array_equal(lowest_bits(alone.view(np.int64)), places)
    np.testing.assert_array_equal(
        lowest_bits((alone | (np.uint64(1) << np.uint64(63))).view(np.int64)), places
    )
