"""Walls of vessels of which one side was seen: the other is as close behind as walls are.

A bowl's outside lies a few millimetres behind the inside that a camera saw, a plate is hollow below its
floor, and a mug's cavity goes on below what was seen of it. Knows a profile's table of depths; knows nothing
of points, images, axes or maps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapping.compiled import compiled
from reconstruction.surface.profile_depth import CELL, NEAR, THINNEST, UNKNOWN
from reconstruction.surface.unseen_cavity import DEEP

GAP = 2
"""Fewer empty cells than this between a floor and what carries it are not believed."""
FOOT = 0.02
"""Below a floor higher than this over the end of the outside [m] it is not known what there is: the lid of a
can. Of 45 cups, bowls and plates lower ones had floors of 1 to 8 mm, one mug's was full."""
LEAST_FLOOR = 2
"""The floor of a cavity was seen where at least so many cells of it were."""
OF_RADIUS = 0.8
"""Within this share of the cavity's radius: beside its wall, what was seen is the wall's."""
SHALLOWEST = 0.003
"""A wall that is deeper than this where empty space begins [m] was not seen there: rays passed by."""
LEAST_THICK = 0.25
"""A wall is as thick as it is at this share of the heights: rims and feet are thicker."""
THICK = 0.012
"""Of what is thicker where both sides were seen [m] no wall is known: a roll of tape."""
SHALLOW = 0.25
"""A cavity no deeper than this share of the height may be the hollow in a foot."""


class Opening(NamedTuple):
    """Which way the cavity opens that was seen, and whether it is only a shallow one."""

    upper: bool
    shallow: bool


class _Sides(NamedTuple):
    """Of each height: the outermost and the innermost cell of what may be the body's outermost wall, -1 where
    there is none, the innermost 0 where no cavity was seen; whether the surface is known at either, and how
    thick the wall then is [m]."""

    outer: np.ndarray
    inner: np.ndarray
    outside: np.ndarray
    inside: np.ndarray
    thick: np.ndarray


def thin_walls(depth: np.ndarray) -> Opening | None:
    """Make walls of a vessel, of which one side is known, thin in its table (R, Z) of depths [m], in place;
    None where the cavity seen has no one opening, or walls are thick: these stay as they are.

    What is taken to be empty behind a wall is no deeper than `DEEP`.
    """
    sides = _sides(depth)
    hollow = np.flatnonzero(sides.inner > 0)
    if len(hollow) == 0:
        return None
    thick = _thickness(sides)
    first, last = hollow[0], hollow[-1]
    down, up = (bool((part < 0).all()) for part in (depth[0, :first], depth[0, last + 1 :]))
    if thick > THICK or up == down:  # a ring, or nothing that opens
        return None
    table = depth
    if down:  # the same, turned upside down
        table, (first, last) = depth[:, ::-1].copy(), (depth.shape[1] - 1 - last, depth.shape[1] - 1 - first)
        sides = _Sides(*(part[::-1].copy() for part in sides))
    floor, bottom = _floor(table, sides.inner, first, last), _bottom(sides.outside, first)
    wall = np.float32(min(max(thick, THINNEST), NEAR))
    _thin(table, sides, first, last, floor, bottom, wall)
    if down:
        depth[:] = table[:, ::-1]
    return Opening(up, bool(floor >= 0 and last - floor < SHALLOW * (last - bottom)))


def _thickness(sides: _Sides) -> float:
    """How thick walls are [m] of which both sides were seen, 0 where none was."""
    both = sides.outside & sides.inside
    return float(np.quantile(sides.thick[both], LEAST_THICK)) if both.any() else 0.0


def outermost(depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of each height of a table (R, Z) of depths [m]: the outermost cell of what may be the body (Z,), -1
    where there is none, and whether its surface is known there (Z,)."""
    sides = _sides(depth)
    return sides.outer, sides.outside & (sides.outer >= 0)


def is_ring(depth: np.ndarray) -> bool:
    """Whether the walls of a body with a table (R, Z) of depths [m] are as thick as a roll of tape's."""
    return _thickness(_sides(depth)) > THICK


@compiled
def _sides(depth: np.ndarray) -> _Sides:
    rows, columns = depth.shape
    outer, inner = np.full(columns, -1), np.full(columns, -1)
    outside, inside = np.zeros(columns, np.bool_), np.zeros(columns, np.bool_)
    thick = np.zeros(columns, np.float32)
    for c in range(columns):
        r, known = rows - 1, False
        while r >= 0 and not known:  # what is merely unknown, with empty space within, is beside the body
            while r >= 0 and depth[r, c] < 0:
                r -= 1
            if r < 0:
                break
            outer[c], outside[c], thick[c] = r, depth[r, c] < SHALLOWEST, 0
            while r >= 0 and depth[r, c] >= 0:
                known |= depth[r, c] < UNKNOWN
                thick[c] = max(thick[c], 2 * depth[r, c])
                r -= 1
            inner[c], inside[c] = r + 1, r >= 0 and depth[r + 1, c] < SHALLOWEST
    return _Sides(outer, inner, outside, inside, thick)


@compiled
def _floor(depth: np.ndarray, inner: np.ndarray, first: int, last: int) -> int:
    """The lowest height at which the floor of a cavity was seen, which opens upwards and was seen at the
    heights first..last; -1 where none was."""
    floor, count = -1, 0
    for r in range(int(OF_RADIUS * inner[first]) + 1):
        c = _lowest_empty(depth[r], last)
        if c > 0 and depth[r, c - 1] < UNKNOWN:
            count += 1
            floor = c - 1 if floor < 0 else min(floor, c - 1)
    return floor if count >= LEAST_FLOOR else -1


@compiled
def _bottom(outside: np.ndarray, first: int) -> int:
    """The lowest height at which the outside was seen, without a gap from `first` on."""
    while first > 0 and outside[first - 1]:
        first -= 1
    return first


@compiled
def _lowest_empty(line: np.ndarray, last: int) -> int:
    """The lowest of the empty cells of a line that follow each other downwards from `last`; -1 where none
    is."""
    c = last
    while c >= 0 and line[c] < 0:
        c -= 1
    return c + 1 if c < last else -1


@compiled
def _thin(
    depth: np.ndarray, sides: _Sides, first: int, last: int, floor: int, bottom: int, wall: float
) -> None:
    """As `thin_walls`, of a cavity that opens upwards, was seen at the heights first..last, and down to its
    floor if that is not -1; its outside was seen down to `bottom`. wall: as thick as its walls are [m]."""
    outer, inner, outside, inside, _ = sides
    rows, columns = depth.shape
    ends = bottom > 0 and depth[0, bottom - 1] < 0
    for c in range(columns):
        if inner[c] > 0 and first <= c <= last:
            for r in range(inner[c]):  # what no ray reached within a cavity, above its floor
                if depth[r, c] >= UNKNOWN:
                    depth[r, c] = -DEEP
            if outside[c] and not inside[c]:
                _empty(depth[:, c], outer[c], -1, -1, wall)
            elif inside[c] and not outside[c]:
                _empty(depth[:, c], inner[c], rows, 1, wall)
        elif outside[c] and bottom <= c < first:
            if floor >= 0:
                if c > floor:
                    _empty(depth[:, c], outer[c], -1, -1, wall)
            elif (c - bottom) * CELL >= wall:
                _empty(depth[:, c], outer[c], -1, -1, wall)
            elif ends:
                for r in range(outer[c]):
                    if depth[r, c] >= UNKNOWN:
                        depth[r, c] = DEEP
    for r in range(inner[last] + 1):
        c = _lowest_empty(depth[r], last) - 1
        if c >= 0 and depth[r, c] < UNKNOWN:
            _empty_below(depth[r], c, outer, outside, r, wall)


@compiled
def _empty(line: np.ndarray, first: int, stop: int, step: int, wall: float) -> None:
    """Take for empty what lies behind a wall's thickness, of a line's cells from `first` to before `stop`."""
    for r in range(first, stop, step):
        if line[r] < 0:
            return
        if line[r] > wall:
            line[r] = max(wall - line[r], -DEEP)


@compiled
def _empty_below(
    line: np.ndarray, top: int, outer: np.ndarray, outside: np.ndarray, r: int, wall: float
) -> None:
    """Take for empty what lies below a floor that was seen at a line's cell `top`, down to what is known not
    to be the body's; r: the line's radius."""
    c, count, within = top, 0, False
    while c >= 0 and line[c] >= 0:
        count += line[c] > wall
        within |= outside[c] and r <= outer[c]
        c -= 1
    if (c >= 0 and count < GAP) or (within and (top - c) * CELL > FOOT):
        return
    _empty(line, top, c, -1, wall)
