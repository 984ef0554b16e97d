"""Features: sparse as dense, found by cells as by search, the same to the bit."""

import numpy as np
import pytest
import torch
from blobs import blobs

from mapping.kernels import dense_features


@pytest.fixture(scope="module", params=[2, 3])
def data(request):
    return blobs(request.param)


def test_sparse_features_agree_with_dense(data):
    from mapping.sparse_features import sparse_features

    X, _, hinges = data
    gamma = np.full(len(hinges), 300.0, np.float32)
    features = sparse_features(X, hinges, gamma, 1e-7, torch.device("cpu"))
    W = torch.randn(len(hinges), 3, generator=torch.Generator().manual_seed(0))
    dense = dense_features(*(torch.from_numpy(a) for a in (X, hinges, gamma)))[features.order]
    torch.testing.assert_close(features.times(W), dense @ W, atol=1e-4, rtol=0)
    R = torch.randn(len(X), 2, generator=torch.Generator().manual_seed(1))
    torch.testing.assert_close(features.rows.transposed(len(hinges)).times(R), dense.T @ R, atol=1e-4, rtol=0)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_features_found_by_cells_are_those_found_by_search(dimensions):
    from mapping.hinge_cells import hinge_cells
    from mapping.hinges import lattice_in_box
    from mapping.sparse_features import _by_search, sparse_features

    rng = np.random.default_rng(2)
    box = np.zeros(dimensions), np.full(dimensions, 0.3)
    lattices = [lattice_in_box(*box, spacing) for spacing in (0.05, 0.02)]
    lattices[1] = lattices[1][rng.random(len(lattices[1])) < 0.3]  # as near surfaces: most nodes are empty
    hinges = np.concatenate(lattices)
    gamma = np.repeat([1000.0, 5000.0], [len(h) for h in lattices]).astype(np.float32)
    X = rng.uniform(-0.2, 0.5, (2000, dimensions)).astype(np.float32)  # some are out of reach
    assert hinge_cells(hinges, gamma, 1e-2) is not None
    features = sparse_features(X, hinges, gamma, 1e-2, torch.device("cpu"))
    W = torch.randn(len(hinges), 3, generator=torch.Generator().manual_seed(0))
    found = torch.empty(len(X), 3)
    found[features.order] = features.times(W)
    for rows, length, column, value in _by_search(X, hinges, gamma, 1e-2):
        sums = torch.zeros(len(rows), 3)
        sums.index_add_(
            0, torch.arange(len(rows)).repeat_interleave(length), value[:, None] * W[column.long()]
        )
        torch.testing.assert_close(found[rows], sums, atol=1e-4, rtol=0)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_neighbours_on_lattices_are_the_nearest_ones(dimensions):
    from mapping.hinge_nodes import HingeNodes, nearest_earlier
    from mapping.hinges import lattice_in_box

    rng = np.random.default_rng(3)
    box, spacings = (np.zeros(dimensions), np.full(dimensions, 0.25)), (0.05, 0.021)
    lattices = [lattice_in_box(*box, spacing) for spacing in spacings]
    lattices[1] = lattices[1][rng.random(len(lattices[1])) < 0.4]
    hinges = np.concatenate(lattices)
    of = np.repeat([0, 1], [len(h) for h in lattices])
    gamma = np.array([1000.0, 5000.0], np.float32)[of]
    nodes = HingeNodes.of(hinges, gamma, 1e-2)
    assert nodes is not None
    rank = rng.permutation(len(hinges))
    found = nearest_earlier(np.arange(len(hinges)), hinges, rank, nodes, 5)
    spacing = np.array(spacings)[of]
    fewer = 0
    for own in range(0, len(hinges), 1 + len(hinges) // 300):
        # Those at the node nearest to it, or beside that, on the other's lattice.
        steps = np.rint(hinges / spacing[:, None]) - np.rint(hinges[own] / spacing[:, None])
        there = (np.abs(steps) <= 1).all(1) & (rank < rank[own])
        wanted = np.sort(np.linalg.norm(hinges[there] - hinges[own], axis=1))[:5]
        near = [other for other in found[own] if other != own]
        assert there[near].all()
        assert len(set(near)) == len(near) == len(wanted)
        np.testing.assert_allclose(np.linalg.norm(hinges[near] - hinges[own], axis=1), wanted, atol=1e-6)
        fewer += len(near) < 5
    assert 0 < fewer < 150  # of up to 300


@pytest.mark.parametrize("case", ["scattered", "many scattered", "twice in one place", "a width each"])
def test_hinge_points_on_no_lattice_are_searched_for(case):
    from mapping.hinge_cells import hinge_cells
    from mapping.hinges import lattice_in_box

    hinges = lattice_in_box(np.zeros(3), np.full(3, 0.2), 0.05)
    gamma = np.full(len(hinges), 500, np.float32)
    assert hinge_cells(hinges, gamma, 1e-2) is not None
    if case == "scattered":
        hinges = hinges + np.random.default_rng(0).normal(0, 0.01, hinges.shape).astype(np.float32)
    elif case == "many scattered":
        # So many that float32 leaves them multiples of its last bit along each axis.
        hinges = np.random.default_rng(0).uniform(0.5, 1, (20_000, 3)).astype(np.float32)
        gamma = np.full(len(hinges), 500, np.float32)
    elif case == "twice in one place":
        hinges = np.concatenate([hinges, hinges[:1]])
        gamma = np.append(gamma, gamma[:1])
    else:
        gamma = np.linspace(400, 600, len(hinges)).astype(np.float32)
    assert hinge_cells(hinges, gamma, 1e-2) is None


def test_parts_of_sparse_rows_make_up_the_whole(data):
    from mapping.sparse_features import sparse_features

    X, _, hinges = data
    gamma = np.full(len(hinges), 300.0, np.float32)
    rows = sparse_features(X, hinges, gamma, 1e-3, torch.device("cpu")).rows
    W = torch.randn(len(hinges), 3, generator=torch.Generator().manual_seed(0))
    for count in (1, 2, 7):
        assert torch.equal(torch.cat([part.times(W) for part in rows.split(count)]), rows.times(W))


def test_features_are_the_same_to_the_bit_whenever_they_are_made():
    # MKL splits products over the threads it believes to have, which changes the last bit: with threads
    # that were not told their share, one call in six differed, and the fit took other steps.
    from mapping.sparse_features import sparse_features

    rng = np.random.default_rng(5)
    X = rng.normal(0, 0.1, (4000, 3)).astype(np.float32)
    hinges = rng.normal(0, 0.1, (2000, 3)).astype(np.float32)
    gamma = np.full(len(hinges), 1000, np.float32)
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        made = [sparse_features(X, hinges, gamma, 3e-3, torch.device("cpu")).rows.values for _ in range(30)]
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(made[0], other) for other in made[1:])
