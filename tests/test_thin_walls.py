"""Walls of vessels of which one side was seen."""

from __future__ import annotations

import numpy as np
import pytest

from reconstruction.surface.profile_depth import CELL, EMPTY, NEAR, THINNEST, UNKNOWN
from reconstruction.surface.thin_walls import thin_walls

ROWS, COLUMNS = 40, 70
radii = CELL * np.arange(ROWS)[:, None]
heights = CELL * np.arange(COLUMNS)[None]
GROUND = 0.010


def profile(
    radius: float,
    top: float,
    thick: float = 0.004,
    floor: float | None = None,
    seen_to: float = 0.0,
) -> np.ndarray:
    """Table of depths of an upright vessel on the ground: its outside was seen, and its inside from the rim
    down to a height or to its floor [m]."""
    behind = radius - radii + 0 * heights  # the outside
    before = radii - (radius - thick) + 0 * heights  # the inside
    table = np.where(behind < -NEAR, EMPTY, np.where(behind < NEAR, behind, UNKNOWN))
    lit = (heights >= max(seen_to, floor or 0)) & (radii < radius - thick / 2)
    inner = np.where(before < -NEAR, EMPTY, np.minimum(before, behind))
    table = np.where(lit, inner, table)
    if floor is not None:
        table = np.where(
            (heights < floor) & (radii < radius - thick), np.minimum(table, _known(floor - heights)), table
        )
    table = np.where(heights > top, np.maximum(top - heights, EMPTY), table)
    return np.where(heights < GROUND, np.maximum(heights - GROUND, EMPTY), table).astype(np.float32)


def _known(depth: np.ndarray) -> np.ndarray:
    return np.where(depth < NEAR, depth, UNKNOWN)


def at(table: np.ndarray, radius: float, height: float) -> float:
    return float(table[round(radius / CELL), round(height / CELL)])


def test_a_mugs_cavity_goes_on_below_what_was_seen_of_it() -> None:
    table = profile(0.040, 0.110, seen_to=0.080)
    assert at(table, 0.010, 0.050) == pytest.approx(UNKNOWN)
    opening = thin_walls(table)
    assert opening is not None
    assert opening.upper
    assert not opening.shallow
    assert at(table, 0.010, 0.050) < 0  # the cavity
    assert at(table, 0.038, 0.050) > 0
    assert at(table, 0.034, 0.050) < 0
    assert at(table, 0.010, GROUND + 0.002) > 0  # its floor


def test_what_opens_downwards_is_treated_alike() -> None:
    table = profile(0.040, 0.110, seen_to=0.080)
    turned = np.ascontiguousarray(table[:, ::-1])
    thin_walls(table)
    opening = thin_walls(turned)
    assert opening is not None
    assert not opening.upper
    np.testing.assert_array_equal(turned, table[:, ::-1])


def test_a_bowls_outside_is_close_behind_its_inside() -> None:
    table = profile(0.040, 0.060, floor=0.024)
    outside = (radii > 0.038) & (heights > GROUND) & (heights < 0.060)
    table[outside & (table > EMPTY)] = UNKNOWN  # nobody saw it
    table[(table < 0) & (radii > 0.038) & (heights > GROUND) & (heights < 0.060)] = UNKNOWN
    assert thin_walls(table) is not None
    assert at(table, 0.038, 0.040) > 0
    assert at(table, 0.044, 0.040) < 0
    assert at(table, 0.010, 0.022) > 0
    assert at(table, 0.010, 0.014) < 0


def test_below_a_sunken_lid_nothing_is_known() -> None:
    table = profile(0.040, 0.110, floor=0.104)
    before = table.copy()
    opening = thin_walls(table)
    assert opening is not None
    assert opening.shallow
    inside = (radii < 0.030) & (heights < 0.104 - NEAR)
    np.testing.assert_array_equal(table[inside], before[inside])


def test_rings_and_thick_walls_stay_as_they_are() -> None:
    ring = profile(0.040, 0.060, thick=0.004, seen_to=0.0)
    ring[(radii < 0.030) & (heights > -1)] = EMPTY  # one sees through
    thick = profile(0.060, 0.110, thick=0.030, seen_to=0.080)
    thick[(radii > 0.030 + NEAR) & (radii < 0.060 - NEAR) & (heights < 0.1) & (heights > GROUND)] = UNKNOWN
    for table in (ring, thick):
        before = table.copy()
        assert thin_walls(table) is None
        np.testing.assert_array_equal(table, before)


def test_nothing_empty_is_deeper_than_it_may_be() -> None:
    table = profile(0.040, 0.110, seen_to=0.080)
    before = table.copy()
    thin_walls(table)
    changed = table != before
    assert changed.any()
    assert table[changed].min() > -THINNEST
