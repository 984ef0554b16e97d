"""Ends of round bodies that nobody saw."""

from __future__ import annotations

import numpy as np
import pytest

from reconstruction.surface.profile_depth import CELL, EMPTY, UNKNOWN
from reconstruction.surface.round_body import RoundBody
from reconstruction.surface.unseen_end import with_ends

RADIUS, SEEN = 0.04, 0.05
"""Of a body, and the height below which nothing of it was seen [m]."""
ROWS, COLUMNS = 30, 60
TURN = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]], np.float32)
"""It lies: its axis runs along x."""
SPACING = 0.005
CORNER = np.array([-0.02, -0.06, -0.06])
NODES = CORNER + SPACING * np.moveaxis(np.indices((36, 25, 25)), 0, -1)


TOP = CELL * (COLUMNS - 1)


def body(known: float | None = None, over: bool = False, taper: float = 0.0) -> RoundBody:
    """A can whose side was seen from SEEN up to its lid; known: its end was not, but where nothing is of it;
    over: turned over; taper: it is so much narrower below SEEN than at it, and wider above [m/m]."""
    radius, height = CELL * np.arange(ROWS)[:, None], CELL * np.arange(COLUMNS)[None]
    side = np.clip(RADIUS + taper * (height - SEEN) - radius, EMPTY, 0.0025)
    table = np.where(height >= SEEN, np.minimum(side, 0.1 - height), UNKNOWN)
    if known is not None:
        table = np.where(height < known, np.maximum(height - known, EMPTY), table)
    table = np.maximum(table, EMPTY).astype(np.float32)
    return RoundBody(TURN, np.zeros(2), 0.0, table[:, ::-1].copy() if over else table)


def log_odds(end: float, over: bool = False) -> np.ndarray:
    """A map in which the body ends at a height [m], as rough as maps are."""
    rough = 0.8 * np.random.default_rng(0).normal(size=NODES.shape[:3])
    height = TOP - NODES[..., 0] if over else NODES[..., 0]
    return (300 * (height - end) + rough).astype(np.float32)


def lying(radius: float, height: float) -> np.ndarray:
    angle = np.linspace(0, 2 * np.pi, 12)
    around = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(12, height)], 1)
    return (around @ TURN).astype(np.float32)


@pytest.mark.parametrize("over", [False, True])
def test_an_end_is_flat_where_the_map_ends_on_average(over: bool) -> None:
    rough = body(over=over)
    found, places = with_ends(rough, log_odds(0.042, over), CORNER, SPACING, 0.004)

    def depth(of: RoundBody, radius: float, height: float) -> np.ndarray:
        return of.depth(lying(radius, TOP - height if over else height))

    ends = TOP - places[:, 0] if over else places[:, 0]
    assert np.ptp(ends) < 1e-6
    assert ends[0] == pytest.approx(0.042, abs=0.002)
    assert np.hypot(places[:, 1], places[:, 2]).max() == pytest.approx(RADIUS, abs=0.003)
    for radius in (0.005, 0.02, 0.034):
        assert (depth(found, radius, ends[0] + 0.0015) > 0).all()
        assert (depth(found, radius, ends[0] - 0.0015) < 0).all()
        assert (depth(rough, radius, 0.042) >= UNKNOWN).all()
    assert (depth(found, RADIUS - 0.002, 0.046) > 0).all()  # its side goes on
    assert (depth(found, RADIUS + 0.003, 0.046) < 0).all()


def test_a_ball_goes_on_as_narrow_as_it_becomes() -> None:
    found, places = with_ends(body(taper=0.5), log_odds(0.040), CORNER, SPACING, 0.004)
    height = float(places[0, 0]) + 0.002
    radius = RADIUS - 0.5 * (SEEN - height)
    assert (found.depth(lying(radius - 0.003, height)) > 0).all()
    assert (found.depth(lying(radius + 0.003, height)) < 0).all()


@pytest.mark.parametrize(("wall", "closed"), [(0.016, False), (0.005, True)])
def test_mugs_get_a_bottom_and_rolls_of_tape_none(wall: float, closed: bool) -> None:
    radius, height = CELL * np.arange(ROWS)[:, None], CELL * np.arange(COLUMNS)[None]
    across = np.maximum(np.minimum(RADIUS - radius, radius - (RADIUS - wall)), EMPTY)
    across = np.where((height < SEEN + 0.004) & (radius < RADIUS - wall / 2), UNKNOWN, across)
    table = np.where(height < SEEN, UNKNOWN, np.minimum(across, 0.1 - height))
    seen = RoundBody(TURN, np.zeros(2), 0.0, table.astype(np.float32))
    _, places = with_ends(seen, log_odds(0.042), CORNER, SPACING, 0.004)
    assert (len(places) > 0) == closed


def test_a_bowl_upside_down_stays_open() -> None:
    full = body()
    inside = (CELL * np.arange(ROWS)[:, None] < RADIUS - 0.005) & (CELL * np.arange(COLUMNS)[None] >= SEEN)
    table = np.where(inside & (CELL * np.arange(COLUMNS)[None] < 0.095), np.float32(-0.0025), full.table)
    bowl = RoundBody(TURN, np.zeros(2), 0.0, table)
    assert len(with_ends(full, log_odds(0.042), CORNER, SPACING, 0.004)[1])
    assert len(with_ends(bowl, log_odds(0.042), CORNER, SPACING, 0.004)[1]) == 0


def test_what_stands_on_a_table_ends_there() -> None:
    found, places = with_ends(body(known=0.046), log_odds(0.055), CORNER, SPACING, 0.004)
    np.testing.assert_allclose(places[:, 0], 0.046, atol=0.0005)
    assert (found.depth(lying(0.02, 0.0475)) > 0).all()


@pytest.mark.parametrize(("known", "end"), [(0.05, 0.03), (None, -0.03)])
def test_seen_ends_and_far_ones_stay(known: float | None, end: float) -> None:
    before = body(known)
    found, places = with_ends(before, log_odds(end), CORNER, SPACING, 0.004)
    assert len(places) == 0
    np.testing.assert_array_equal(found.table, before.table)


def ball(wide: float = 0.04, high: float = 0.04, known: float | None = None) -> RoundBody:
    """A ball or egg on 0.02 m, seen from a little below its middle upwards; known: nothing is below this."""
    radius, height = CELL * (np.arange(ROWS)[:, None] + 0.0), CELL * np.arange(COLUMNS)[None]
    middle = 0.02 + high
    away = np.hypot(radius / wide, (height - middle) / high)
    table = np.where(
        height >= middle - 0.2 * high, np.clip((1 - away) * min(wide, high), EMPTY, 0.0025), UNKNOWN
    )
    if known is not None:
        table = np.where(height < known, np.maximum(height - known, EMPTY), table)
    return RoundBody(TURN, np.zeros(2), 0.0, np.maximum(table, EMPTY).astype(np.float32))


@pytest.mark.parametrize("high", [0.04, 0.045, 0.035])
def test_balls_and_eggs_end_round(high: float) -> None:
    found, places = with_ends(ball(high=high), log_odds(0.03), CORNER, SPACING, 0.004)
    assert places[:, 0].min() == pytest.approx(0.02, abs=0.002)  # not where the map ends
    off_axis = np.hypot(places[:, 1], places[:, 2])
    np.testing.assert_allclose(np.hypot(off_axis / 0.04, (places[:, 0] - 0.02 - high) / high), 1, atol=0.03)
    for share in (0.5, 0.7, 0.9):
        height = 0.02 + high * (1 - share)
        at = lying(0.04 * np.sqrt(1 - share**2), height)
        assert np.abs(found.depth(at)).max() < 0.003


def test_a_ball_ends_where_nothing_is_known_to_be() -> None:
    found, places = with_ends(ball(known=0.026), log_odds(0.03), CORNER, SPACING, 0.004)
    assert places[:, 0].min() == pytest.approx(0.026, abs=0.001)
    assert found.depth(lying(0.0, 0.022)).max() < 0
