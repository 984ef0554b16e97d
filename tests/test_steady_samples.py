"""Samples by place and seed: they stay where they are; and what was asked of them is not asked again."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from mapping.known_points import among, first_in_cells
from mapping.near_points import near_any
from mapping.steady_samples import steady_chance, steady_jitter, steady_lattice, steady_subsample
from reconstruction.prior.remembered import remembered

RNG = np.random.default_rng(0)


def rows(points: np.ndarray) -> set[bytes]:
    return {row.tobytes() for row in points}


def test_a_larger_box_keeps_the_samples_of_a_smaller_one() -> None:
    small = steady_lattice(np.zeros(3), np.full(3, 0.1), 0.02, 7)
    large = steady_lattice(np.full(3, -0.05), np.full(3, 0.13), 0.02, 7)
    assert len(small) == 125
    assert rows(small) < rows(large)
    assert not rows(small) & rows(steady_lattice(np.zeros(3), np.full(3, 0.1), 0.02, 8))


def test_each_cell_has_one_sample_evenly_drawn() -> None:
    points = steady_lattice(np.full(3, -1.0), np.ones(3), 0.1, 0)
    cells = np.floor(points / 0.1).astype(int)
    assert len(np.unique(cells, axis=0)) == len(points) == 8000
    within = points / 0.1 - cells
    assert abs(within.mean(0) - 0.5).max() < 0.02
    assert abs(within.var(0) - 1 / 12).max() < 0.005
    assert abs(np.corrcoef(within.T) - np.eye(3)).max() < 0.04
    flat = steady_lattice(np.zeros(3), np.array([0.1, 0.1, 0.0]), 0.02, 7)
    assert len(flat) == 25


def test_lattice_points_move_within_their_cells() -> None:
    lattice = (0.01 * RNG.integers(-20, 20, (500, 3))).astype(np.float32)
    moved = steady_jitter(lattice, 0.01, 3)
    assert abs(moved - lattice).max() <= 0.005 + 1e-6
    assert abs((moved - lattice).mean(0)).max() < 0.0006
    np.testing.assert_array_equal(steady_jitter(lattice[::7], 0.01, 3), moved[::7])


def test_a_voxel_keeps_its_point_when_a_view_is_added() -> None:
    first, second = RNG.uniform(-0.1, 0.1, (2, 3000, 3)).astype(np.float32)
    alone = steady_subsample(first, np.zeros(3000, int), 0.02, 5)
    both = np.concatenate([first, second])
    kept = both[steady_subsample(both, np.repeat([0, 1], 3000), 0.02, 5)]
    assert rows(first[alone]) <= rows(kept)
    cells = np.floor(kept.astype(float) / 0.02).astype(int)
    assert len(np.unique(cells, axis=0)) == len(kept)
    assert len(kept) == len(np.unique(np.floor(both.astype(float) / 0.02), axis=0))
    wide = np.array([[0, 0, 0], [1000, 1000, 1000], [0.001, 0, 0]], np.float32)
    assert len(steady_subsample(wide, np.zeros(3, int), 0.01, 5)) == 2
    assert len(steady_subsample(first[:0], np.zeros(0, int), 0.01, 5)) == 0


def test_chances_are_even_and_of_the_place() -> None:
    points = RNG.normal(size=(4000, 3)).astype(np.float32)
    chance = steady_chance(points, 1)
    assert abs(np.quantile(chance, [0.25, 0.5, 0.75]) - [0.25, 0.5, 0.75]).max() < 0.03
    np.testing.assert_array_equal(steady_chance(points[::3], 1), chance[::3])
    assert abs(np.corrcoef(chance, steady_chance(points, 2))[0, 1]) < 0.06


def test_known_points_are_found_to_the_bit() -> None:
    known = RNG.normal(size=(1000, 3)).astype(np.float32)
    asked = np.concatenate([known[[5, 900]], np.nextafter(known[:1], np.float32(9)), known[:1]])
    np.testing.assert_array_equal(among(asked, known), [5, 900, -1, 0])
    assert (among(asked, known[:0]) == -1).all()


def test_one_point_a_cell_stays() -> None:
    points = RNG.uniform(-0.1, 0.1, (5000, 3)).astype(np.float32)
    kept = first_in_cells(points, 0.02)
    cells, first = np.unique(np.floor(points / 0.02), axis=0, return_index=True)
    np.testing.assert_array_equal(kept, np.sort(first))
    assert 500 < len(cells) < 1200


def test_near_points_are_those_of_a_tree() -> None:
    points, others = RNG.normal(size=(2, 2000, 3)).astype(np.float32)
    expected = cKDTree(others).query(points)[0]
    for distance in (0.01, 0.1, 0.4):
        clear = abs(expected - distance) > 1e-6
        np.testing.assert_array_equal(
            near_any(points, others, distance)[clear], (expected <= distance)[clear]
        )
    assert not near_any(points, others[:0], 1.0).any()


def test_what_was_answered_is_not_asked_again() -> None:
    asked: list[int] = []

    def ask(points: np.ndarray) -> np.ndarray:
        asked.append(len(points))
        return points[:, :2] * 2

    points = RNG.normal(size=(300, 3)).astype(np.float32)
    memo: dict[Any, Any] = {}
    first = remembered(memo, "a", points[:200], ask)
    again = remembered(memo, "a", points[100:][::-1].copy(), ask)
    np.testing.assert_array_equal(again, points[100:][::-1, :2] * 2)
    assert asked == [200, 100]
    np.testing.assert_array_equal(first, points[:200, :2] * 2)  # later answers leave it alone
    remembered(memo, "a", points[250:], ask)
    assert asked == [200, 100]
