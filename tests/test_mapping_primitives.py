"""Hinge placement, sampling primitives and the preconditioner."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from mapping.hinges import lattice_in_box, lattice_near_centres, lattice_near_points, random_subset
from mapping.lattice import NEGLIGIBLE
from mapping.lattice_products import kernel_table
from mapping.preconditioner import NEIGHBOURS, sparse_factor
from mapping.samples import (
    along_rays,
    jittered_lattice,
    merge_in_cells,
    shift_along_rays,
    voxel_subsample,
    within,
)
from mapping.threads import map_in_threads
from reconstruction.prior.trilinear import corners


def test_lattice_in_box_holds_the_multiples_of_the_spacing():
    points = lattice_in_box(np.array([-0.1, 0.0]), np.array([0.1, 0.05]), 0.05)
    assert len(points) == 5 * 2
    np.testing.assert_allclose(points / 0.05, np.rint(points / 0.05), atol=1e-5)


def test_lattice_near_points_agrees_with_distances():
    points = np.random.default_rng(0).uniform(-0.2, 0.2, (30, 3))
    near = lattice_near_points(points, 0.06, 0.03)
    distance = np.linalg.norm(near[:, None] - points[None], axis=2).min(1)
    # Distances are measured from the lattice cell that holds a point, half a diagonal of error at most.
    assert distance.max() <= 0.06 + 0.03 * np.sqrt(3) / 2
    lattice = lattice_in_box(points.min(0) - 0.1, points.max(0) + 0.1, 0.03)
    sure = lattice[np.linalg.norm(lattice[:, None] - points[None], axis=2).min(1) < 0.03]
    found = {tuple(p) for p in np.rint(near / 0.03).astype(int)}
    assert all(tuple(p) in found for p in np.rint(sure / 0.03).astype(int))


@pytest.mark.parametrize("distance", [0.0, 0.01, 0.02, 0.025])
def test_lattice_near_points_is_a_ball_around_each_cell(distance):
    points = np.random.default_rng(1).uniform(-0.05, 0.05, (20, 3))
    near = np.rint(lattice_near_points(points, distance, 0.01) / 0.01).astype(int)
    cells = np.rint(points / 0.01)
    around = np.stack(np.meshgrid(*[np.arange(-10, 11)] * 3, indexing="ij"), -1).reshape(-1, 3)
    gap = np.linalg.norm(around[:, None] - cells[None], axis=2).min(1)
    np.testing.assert_array_equal(near, around[gap <= distance / 0.01 + 1e-9])


def test_lattice_near_no_points_is_empty():
    assert lattice_near_points(np.empty((0, 3), np.float32), 0.02, 0.01).shape == (0, 3)


def test_lattice_near_centres_stays_within_the_radius():
    centres = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]])
    near = lattice_near_centres(centres, 0.15, 0.05)
    assert np.linalg.norm(near[:, None] - centres[None], axis=2).min(1).max() <= 0.15 + 1e-6
    assert len(near) == 2 * len(lattice_near_centres(centres[:1], 0.15, 0.05))


def test_random_subset_is_reproducible_and_without_repeats():
    points = np.arange(60.0).reshape(20, 3)
    drawn = [random_subset(points, 7, np.random.default_rng(4)) for _ in range(2)]
    np.testing.assert_array_equal(*drawn)
    assert len(np.unique(drawn[0], axis=0)) == 7
    assert random_subset(points, 99, np.random.default_rng(4)) is points


@settings(deadline=None, max_examples=25)
@given(st.integers(1, 200), st.floats(0.01, 0.5), st.integers(0, 9))
def test_voxel_subsample_keeps_one_point_a_voxel(count, size, seed):
    points = np.random.default_rng(seed).uniform(0, 1, (count, 3))
    kept = voxel_subsample(points, size, np.random.default_rng(seed))
    cells = np.floor((points - points.min(0)) / size).astype(int)
    assert len(np.unique(cells[kept], axis=0)) == len(kept) == len(np.unique(cells, axis=0))


@settings(deadline=None, max_examples=25)
@given(st.integers(1, 200), st.integers(1, 3), st.floats(0.001, 0.5), st.integers(0, 9))
def test_merging_keeps_each_class_s_weight_and_mean(count, dimensions, size, seed):
    # The smallest sizes have far more cells than samples and are merged by sorting, the others in a table.
    rng = np.random.default_rng(seed)
    points, classes = rng.uniform(0, 1, (count, dimensions)), rng.integers(0, 3, count)
    weights = rng.uniform(0.1, 1, count)
    X, y, w = merge_in_cells(points, classes, weights, size)
    assert w.min() > 0
    for label in range(3):
        ours, given = y == label, classes == label
        np.testing.assert_allclose(w[ours].sum(), weights[given].sum())
        np.testing.assert_allclose(w[ours] @ X[ours], weights[given] @ points[given], atol=1e-9)
    cells = np.column_stack([classes, np.floor(points / size).astype(int)])
    assert len(X) == len(np.unique(cells, axis=0))


def test_merging_changes_smooth_sums_in_second_order_only():
    rng = np.random.default_rng(0)
    points = rng.normal(0, 1, (20_000, 2))

    def error(size: float) -> float:
        X, _, w = merge_in_cells(points, np.zeros(len(points), int), np.ones(len(points)), size)
        exact, merged = np.exp(-0.5 * (points**2).sum(1)).mean(), w @ np.exp(-0.5 * (X**2).sum(1)) / w.sum()
        return abs(merged - exact) / exact

    assert error(0.35) < 0.01
    assert error(0.35) / error(0.7) == pytest.approx(0.25, rel=0.2)


def test_merging_nothing_gives_nothing():
    X, y, w = merge_in_cells(np.empty((0, 2)), np.empty(0, int), np.empty(0), 0.1)
    assert X.shape == (0, 2)
    assert len(y) == len(w) == 0


def test_shift_along_rays_moves_along_the_ray():
    origin = np.array([0.0, 0.0, 1.0])
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    moved = shift_along_rays(origin, points, 0.1)
    np.testing.assert_allclose(np.linalg.norm(moved - points, axis=1), 0.1)
    np.testing.assert_allclose(moved[0], [0, 0, -0.1])


def test_along_rays_fills_each_ray_before_its_end():
    origin = np.zeros(3)
    points = np.array([[1.0, 0.0, 0.0], [0.0, 0.35, 0.0]])
    free = along_rays(origin, points, 0.1, 0.0, np.random.default_rng(0))
    on_first = free[np.abs(free[:, 1]) < 1e-9]
    assert len(on_first) == 10
    np.testing.assert_array_equal(np.floor(np.sort(on_first[:, 0]) / 0.1), np.arange(10))
    assert free[:, 1].max() < 0.35


def test_jittered_lattice_is_even():
    points = jittered_lattice(np.zeros(3), np.ones(3), 0.1, np.random.default_rng(0))
    cells = np.floor(points / 0.1).astype(int)
    assert len(points) == len(np.unique(cells, axis=0)) == 1000


def test_corners_agree_with_grid_sample():
    rng, shape = np.random.default_rng(0), (3, 5, 2)
    volume = rng.normal(size=shape).astype(np.float32)
    points = rng.uniform(-1.3, 1.3, (500, 3)).astype(np.float32)  # some beyond the lattice
    index, weight = corners(points.T, shape)
    grid = torch.from_numpy(points[None, :, None, None, ::-1].copy())
    expected = torch.nn.functional.grid_sample(
        torch.from_numpy(volume)[None, None], grid, padding_mode="border", align_corners=False
    )
    found = (volume.reshape(-1)[index] * weight).sum(0)
    np.testing.assert_allclose(found, expected.reshape(-1).numpy(), atol=1e-5)


def test_within_agrees_with_distances():
    rng = np.random.default_rng(0)
    points, centres = rng.uniform(-1, 1, (200, 3)), rng.uniform(-1, 1, (3, 3))
    expected = np.linalg.norm(points[:, None] - centres[None], axis=2).min(1) <= 0.4
    np.testing.assert_array_equal(within(points, centres, 0.4), expected)


def even_gram(places: np.ndarray, gamma: np.ndarray) -> np.ndarray:
    """Correlations of Gaussian features under samples of even density, by brute force over a fine lattice."""
    axis = np.arange(-0.3, 0.3, 0.01)
    samples = np.stack(np.meshgrid(*[axis] * places.shape[1], indexing="ij"), -1).reshape(-1, places.shape[1])
    phi = np.exp(-gamma * ((samples[:, None] - places[None]) ** 2).sum(2))
    gram = phi.T @ phi
    scale = 1 / np.sqrt(np.diag(gram))
    return scale[:, None] * gram * scale


def test_the_factor_is_exact_when_every_row_couples_to_all_earlier_ones():
    rng = np.random.default_rng(0)
    count = NEIGHBOURS  # each row has at most this many earlier ones
    places = rng.uniform(-0.010, 0.010, (count, 2)).astype(np.float32)
    gamma = rng.uniform(500, 4000, count).astype(np.float32)
    diagonal = rng.uniform(1, 3, count).astype(np.float32)
    gram = np.sqrt(np.outer(diagonal, diagonal)) * even_gram(places, gamma)
    factor = sparse_factor(places, gamma).scaled(torch.from_numpy(diagonal))
    G = factor.pull(torch.eye(count)).numpy()
    whitened = G @ gram @ G.T
    # The ridge keeps eigenvalues a little below 1; without whitening they spread over orders of magnitude.
    assert np.linalg.eigvalsh(gram).min() < 0.1
    eigenvalues = np.linalg.eigvalsh(whitened)
    assert 0.2 < np.median(eigenvalues) <= eigenvalues.max() < 1.05
    np.testing.assert_allclose(factor.push(torch.eye(count)).numpy(), G.T, atol=1e-6)
    # A diagonal for each class: each column as its own factor has it.
    both = sparse_factor(places, gamma).scaled(torch.from_numpy(np.column_stack([diagonal, 5 * diagonal])))
    g = torch.from_numpy(rng.normal(size=(count, 2)).astype(np.float32))
    other = sparse_factor(places, gamma).scaled(torch.from_numpy(5 * diagonal))
    for ours, theirs, alone in ((both.pull, factor.pull, other.pull), (both.push, factor.push, other.push)):
        want = torch.cat([theirs(g[:, :1]), alone(g[:, 1:])], 1)
        torch.testing.assert_close(ours(g), want, atol=1e-5, rtol=1e-5)


def test_the_factor_improves_the_condition_number():
    axis = np.arange(-0.1, 0.11, 0.05)
    places = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3).astype(np.float32)
    gamma = np.full(len(places), 500, np.float32)
    squared = ((places[:, None] - places[None]) ** 2).sum(2)
    gram = np.exp(-250 * squared) + 1e-3 * np.eye(len(places))
    factor = sparse_factor(places, gamma).scaled(torch.ones(len(places)))
    G = factor.pull(torch.eye(len(places))).numpy().astype(float)
    assert np.linalg.cond(G @ gram @ G.T) < 0.1 * np.linalg.cond(gram)


def test_products_of_kernel_values_stay_in_the_normal_range_of_float32():
    # Arithmetic on subnormal numbers made lattices three times as slow.
    nodes = np.linspace(-0.2, 0.2, 65)
    table = kernel_table(nodes, nodes, 8000.0, NEGLIGIBLE)
    assert table[table > 0].min() ** 3 > torch.finfo(torch.float32).tiny
    assert table.max() == 1


def test_map_in_threads_keeps_order_and_restores_the_thread_count():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        inside = map_in_threads(lambda i: (i, torch.get_num_threads()), range(50))
        assert inside == [(i, 1) for i in range(50)]
        assert torch.get_num_threads() == 2
        with pytest.raises(ZeroDivisionError):
            map_in_threads(lambda i: 1 / i, [1, 0])
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)
