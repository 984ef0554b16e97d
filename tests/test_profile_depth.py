"""Tables of how deep places lie behind a profile: walls, their ends, wrong normals, and what is within."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from reconstruction.surface.profile_depth import CELL, EMPTY, UNKNOWN, depth_table, is_vessel, no_steeper
from reconstruction.surface.unseen_cavity import DEEP, Cavity, cavity, fill, hollow_out

ROWS, COLUMNS, LOW = 48, 60, -0.02


def upright(radius: float, inside: bool = False, count: int = 600) -> tuple[np.ndarray, np.ndarray]:
    """A profile (M, 2) of an upright wall from height 0 to 60 mm, and its normals into the solid."""
    rng = np.random.default_rng(0)
    profile = np.stack(
        [np.full(count, radius) + 3e-4 * rng.normal(size=count), rng.uniform(0, 0.06, count)], 1
    )
    return profile, np.tile([1.0 if inside else -1.0, 0.0], (count, 1))


def cell(radius: float, height: float) -> tuple[int, int]:
    return round(radius / CELL), round((height - LOW) / CELL)


def rays_passed(height: float, beyond: float = np.inf) -> np.ndarray:
    """Which cells are empty: those above a height, and those farther out than a radius."""
    r, z = np.meshgrid(np.arange(ROWS) * CELL, LOW + np.arange(COLUMNS) * CELL, indexing="ij")
    return (z > height) | (r > beyond)


def test_depths_are_distances_to_the_wall() -> None:
    table = depth_table(*upright(0.04), LOW, rays_passed(0.066, beyond=0.043))
    for off in (-0.004, -0.002, 0.0, 0.002, 0.004):
        assert abs(table[cell(0.04 + off, 0.03)] + off) < 4e-4
    assert table[cell(0.02, 0.03)] >= UNKNOWN


def test_a_wall_ends_where_rays_passed_beyond_it() -> None:
    table = depth_table(*upright(0.04), LOW, rays_passed(0.059))
    assert table[cell(0.038, 0.058)] > 0
    assert (table[cell(0.038, 0.064)[0], cell(0.038, 0.064)[1] :] < 0).all()
    # Where none did it goes on a little: nobody saw its foot.
    assert table[cell(0.038, -0.004)] > 0


def test_a_few_wrong_normals_open_no_wall() -> None:
    profile, inwards = upright(0.04)
    wrong = inwards.copy()
    wrong[::40] = [0.34, -0.94]  # planes that reach round an edge
    empty = rays_passed(0.066)
    of_all, of_right = depth_table(profile, wrong, LOW, empty), depth_table(profile, inwards, LOW, empty)
    near = cell(0.036, 0.0)[0], slice(cell(0, 0.005)[1], cell(0, 0.055)[1])
    np.testing.assert_allclose(of_all[near], of_right[near], atol=5e-4)


def test_stray_points_in_a_cavity_make_no_ring() -> None:
    (outer, out), (inner, into) = upright(0.04), upright(0.035, inside=True)
    profile, inwards = np.concatenate([outer, inner]), np.concatenate([out, into])
    empty = rays_passed(0.066, beyond=0.043)
    empty[: cell(0.034, 0)[0]] = True
    stray = np.array([[0.02, 0.04], [0.0203, 0.0404], [0.0198, 0.0408]])
    with_stray = np.concatenate([profile, stray]), np.concatenate([inwards, np.tile([1.0, 0.0], (3, 1))])
    clean, found = depth_table(profile, inwards, LOW, empty), depth_table(*with_stray, LOW, empty)
    np.testing.assert_array_equal(found >= 0, clean >= 0)
    assert found[cell(0.02, 0.04)] < 0


def test_both_sides_of_a_thin_wall_are_kept() -> None:
    sides = upright(0.04), upright(0.037, inside=True)
    profile, inwards = (np.concatenate(part) for part in zip(*sides))
    table = depth_table(profile, inwards, LOW, rays_passed(0.066))
    assert table[cell(0.038, 0.03)] > 0
    assert max(table[cell(0.032, 0.03)], table[cell(0.046, 0.03)]) < 0
    assert is_vessel(inwards)
    assert not is_vessel(sides[0][1])


def test_what_nobody_knows_within_a_surface_is_filled_and_nothing_else() -> None:
    empty = rays_passed(0.066, beyond=0.05)
    table = depth_table(*upright(0.04), LOW, empty)
    filled = table.copy()
    fill(filled)
    middle = cell(0.0, 0.03)[1]
    assert 0 < filled[0, middle] < UNKNOWN
    assert (filled[: cell(0.03, 0)[0], middle] >= DEEP).all()
    np.testing.assert_array_equal(filled[table < UNKNOWN], table[table < UNKNOWN])
    assert filled[cell(0.04, 0)[0] + 8, 2] == table[cell(0.04, 0)[0] + 8, 2]
    above = cell(0.0, 0.075)[1]
    np.testing.assert_array_equal(filled[:, above], table[:, above])


def turned(
    radius_at: Callable[[np.ndarray], np.ndarray], lid_at: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """A profile (M, 2) from height 0 to 60 mm with radii by height, and its normals; with a lid."""
    heights = np.random.default_rng(0).uniform(0, 0.06, 600)
    radii = radius_at(heights)
    slope = (radius_at(heights + 1e-5) - radius_at(heights - 1e-5)) / 2e-5
    inwards = np.stack([-np.ones_like(slope), slope], 1) / np.hypot(1, slope)[:, None]
    profile = np.stack([radii, heights], 1)
    if lid_at is not None:
        lid = np.stack([np.linspace(0, 0.9 * radii.min(), 100), np.full(100, lid_at)], 1)
        profile = np.concatenate([profile, lid])
        inwards = np.concatenate([inwards, np.tile([0.0, 1.0 if lid_at < 0.03 else -1.0], (100, 1))])
    return profile, inwards


def cone(height: np.ndarray) -> np.ndarray:
    return 0.05 - 0.25 * height  # wide below


def test_a_vessel_upside_down_opens_and_a_can_or_ball_does_not() -> None:
    ended = rays_passed(0.06) | ~rays_passed(0.0)  # above it and below it
    found = cavity(*turned(cone, lid_at=0.06), LOW, ended)  # what was its bottom is on top
    assert found is not None
    assert not found.upper
    assert found.bottom == pytest.approx(0.06, abs=2e-3)
    found = cavity(*turned(lambda z: cone(0.06 - z)), LOW, ended)
    assert found is not None
    assert found.upper
    assert found.bottom == pytest.approx(0, abs=2e-3)
    assert cavity(*turned(cone, lid_at=0.0), LOW, ended) is None  # closed where it is wide
    assert cavity(*turned(lambda z: 0.04 + 0 * z, lid_at=0.06), LOW, ended) is None
    ball = turned(lambda z: np.sqrt(0.035**2 - np.minimum(z - 0.03, 0.034) ** 2))
    assert cavity(*ball, LOW, ended) is None
    assert cavity(*turned(lambda z: cone(z) / 3), LOW, ended) is None  # a tool's handle
    # Nobody saw where it ends.
    assert cavity(*turned(cone, lid_at=0.06), LOW, rays_passed(0.06)) is None


def test_a_cavity_that_nobody_saw_has_a_thin_wall_around_it() -> None:
    table = depth_table(*turned(cone, lid_at=0.06), LOW, rays_passed(0.066))
    hollowed = table.copy()
    hollow_out(hollowed, LOW, Cavity(upper=False, bottom=None))
    outside = cone(np.array(0.03))
    assert hollowed[cell(outside - 0.002, 0.03)] > 0.001
    assert (hollowed[: cell(outside - 0.009, 0)[0], cell(0, 0.03)[1]] == -DEEP).all()
    assert hollowed[cell(0.0, 0.058)] > 0.001 > -0.001 > hollowed[cell(0.0, 0.05)]  # below its bottom
    off = table < 0
    np.testing.assert_array_equal(hollowed[off], table[off])


def test_the_bottom_of_a_cavity_that_nobody_saw_is_closed() -> None:
    table = depth_table(*turned(cone), LOW, rays_passed(0.066))
    hollow_out(table, LOW, Cavity(upper=False, bottom=0.06))
    assert table[cell(0.0, 0.058)] == DEEP > 0 > table[cell(0.0, 0.05)]


def test_empty_space_becomes_emptier_with_the_distance() -> None:
    table = np.full((12, 5), EMPTY, np.float32)
    table[:4], table[4] = 0.003, UNKNOWN
    before = table.copy()
    no_steeper(table)
    np.testing.assert_array_equal(table[:5], before[:5])
    np.testing.assert_allclose(
        table[5, 2], 0.001 - 2 * CELL, atol=1e-6
    )  # from the cells before the unknown one
    assert (np.diff(table[5:, 2]) <= 0).all()
    assert (table[5:] < 0).all()
    assert table[-1, 2] == EMPTY
