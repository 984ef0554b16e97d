"""The end of a round body that nobody saw: round where the body is a ball, else flat, where the map says that
the body ends.

A mug that lies shows its side and its mouth; its bottom is the map's guess, which is as rough as the samples
it was fitted to, and cups, cans and bottles have flat ends. Of balls, eggs and most fruits the seen half says
what the other is like. Knows a body's table of depths and a lattice of log odds; knows nothing of images or
meshes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from reconstruction.surface.profile_depth import CELL, EMPTY, THINNEST, UNKNOWN
from reconstruction.surface.refined import values_at
from reconstruction.surface.round_body import RoundBody
from reconstruction.surface.thin_walls import is_ring, outermost
from reconstruction.surface.unseen_cavity import DEEP

UNSEEN, WITHIN = 0.8, 0.9
"""An end was not seen where more than the first share of the table's row beside it is unknown, within the
second share of the radius."""
OPEN = 0.5
"""Where more than this share of the row is empty, the body opens to that end: a bowl upside down."""
CLOSE = 3
"""Where it is known not to go on so many rows beyond, it ends there: it stands on a table."""
AMONG = 6
"""Radius and taper at an end are those of so many rows beside it."""
STEEPEST = 2.0
"""Bodies taper by no more than this, in radius a height: what does is near its end."""
RINGS, ANGLES = 6, 12
"""The map is asked at so many places on a cross-section."""
LIMIT = 2.0
"""Log odds beyond this do not count for more."""
OVAL = (0.6, 1.7)
"""Squared width over height of what counts as a ball: eggs and tangerines do."""
OFF = 0.5
"""Its outline is seen no further than this from the oval on average, and nowhere further than twice this
[cells]."""
UPPER = 0.6
"""It is seen from its middle, or from below it, up to this share of its half height above the middle."""


def with_ends(
    body: RoundBody, log_odds: np.ndarray, corner: np.ndarray, spacing: float, apart: float
) -> tuple[RoundBody, np.ndarray]:
    """The same body with ends, round or flat, where it has ends that nobody saw, and these are near; and
    places (M, 3) float32 [m, table frame] on them, `apart` [m] from each other.

    log_odds: (nx, ny, nz) of the map at corner + spacing * (i, j, k) [m, table frame].
    """
    table, places = body.table.copy(), [np.empty((0, 3), np.float32)]
    if is_ring(table):
        return body, places[0]
    for up in (False, True):
        rows = table[:, ::-1] if up else table
        place = _unseen_end(rows)
        if place is None:
            continue
        first, radius, taper = place
        end = known = _known_end(rows, first, radius)
        oval = _oval(rows, first)
        if oval is not None:
            _put_round_end(rows, first, oval, known)
            places.append(_cap(body, oval, first, known, up, table.shape[1] - 1, apart))
            continue
        if known is None or first - known > CLOSE:
            beyond = np.arange(first - 1, -1 if known is None else int(np.ceil(known)) - 1, -1)
            heights = body.height + CELL * (table.shape[1] - 1 - beyond if up else beyond)
            filled = _filled(body, log_odds, corner, spacing, heights, CELL * radius)
            end = _crossed(filled, first, known)
        if end is not None:
            _put_end(rows, first, radius, taper, end)
            height = body.height + CELL * (table.shape[1] - 1 - end if up else end)
            places.append(_disc(body, CELL * (radius - taper * max(first - end, 0)), height, apart))
    return replace(body, table=table), np.concatenate(places)


def _unseen_end(rows: np.ndarray) -> tuple[int, int, float] | None:
    """The lowest height at which the outside of a body with a table (R, Z) was seen, its radius there, in
    cells, and how much less that becomes a cell downwards; None where it is seen to end there, or opens."""
    outer, seen = outermost(rows)
    at = np.flatnonzero(seen)
    if len(at) == 0 or at[0] == 0:
        return None
    first, near = int(at[0]), at[:AMONG]
    taper = float(np.clip((outer[near[-1]] - outer[first]) / max(near[-1] - first, 1), 0, STEEPEST))
    radius = int(np.median(outer[near] - taper * (near - first)))
    within = slice(max(int(WITHIN * radius), 1))
    unseen = (rows[within, first - 1] >= UNKNOWN).mean() > UNSEEN
    opening = (rows[within, first] < 0).mean() > OPEN
    return (first, radius, taper) if unseen and not opening else None


def _known_end(rows: np.ndarray, first: int, radius: int) -> float | None:
    """Where the body is known to have ended below a height [cells], None where that is not known."""
    for c in range(first - 1, -1, -1):
        line = rows[: max(int(WITHIN * radius), 1), c]
        if (line < 0).mean() > UNSEEN:
            return c - float(np.median(line)) / CELL if np.median(line) > -CELL else float(c + 1)
    return None


def _crossed(filled: np.ndarray, first: int, known: float | None) -> float | None:
    """Where log odds (H,) at the heights below `first` cross 0 [cells], or where the body is known to end;
    None where neither is."""
    empty = np.flatnonzero(filled <= 0)
    if len(empty) == 0:
        return known
    last = int(empty[0])
    if last == 0:
        return float(first)
    return first - last - float(filled[last - 1] / (filled[last - 1] - filled[last]))


def _oval(rows: np.ndarray, first: int) -> tuple[float, float, float] | None:
    """The middle and the half width and half height [cells] of the oval whose upper part, from the height
    `first`, is what a table (R, Z) says of the outside; None where that is none."""
    outer, seen = outermost(rows)
    at = np.flatnonzero(seen)
    radius = outer[at] + rows[outer[at], at] / CELL
    # Its squared radius is a quadratic in the height.
    bent, slope, start = np.polyfit(at, radius**2, 2) if len(at) > AMONG else (0.0, 0.0, 0.0)
    if not OVAL[0] < -bent < OVAL[1]:
        return None
    middle = -slope / (2 * bent)
    wide = float(np.sqrt(max(start - bent * middle**2, 0.0)))
    high = wide / float(np.sqrt(-bent))
    if not (first <= middle and at[-1] > middle + UPPER * high):
        return None
    off = np.abs(_within_oval(radius, at, (middle, wide, high)))
    return (middle, wide, high) if off.mean() < OFF and off.max() < 2 * OFF else None


def _within_oval(r: np.ndarray, c: np.ndarray, oval: tuple[float, float, float]) -> np.ndarray:
    """How far places at radius r and height c lie within an oval [cells], to first order at its outline."""
    middle, wide, high = oval
    away = np.hypot(r / wide, (c - middle) / high)
    steep = np.hypot(r / wide**2, (c - middle) / high**2)
    return (1 - away) * away / np.maximum(steep, 1e-6)


def _put_round_end(
    rows: np.ndarray, first: int, oval: tuple[float, float, float], known: float | None
) -> None:
    """Let the body go on below the height `first` as the oval does, in place, where the table (R, Z) does not
    know; it ends at the height `known` at the latest [cells]."""
    r, c = np.arange(rows.shape[0])[:, None], np.arange(rows.shape[1])[None]
    depth = CELL * np.minimum(_within_oval(r, c, oval), np.inf if known is None else c - known)
    unknown = (rows >= UNKNOWN) & (c < first)
    rows[unknown] = np.clip(depth, EMPTY, DEEP)[unknown]


def _cap(
    body: RoundBody,
    oval: tuple[float, float, float],
    first: int,
    known: float | None,
    up: bool,
    highest: int,
    apart: float,
) -> np.ndarray:
    """Places (M, 3) float32 on an oval below the height `first` [m]; up: its heights are counted from
    `highest` downwards."""
    middle, wide, high = oval
    low = max(first - middle, -high) / high
    x, y = _level(body, CELL * wide * float(np.sqrt(max(1 - low**2, 0.0))), apart)
    away = np.hypot(x - body.axis[0], y - body.axis[1]) / (CELL * wide)
    at = np.maximum(middle - high * np.sqrt(np.maximum(1 - away**2, 0)), -np.inf if known is None else known)
    height = body.height + CELL * (highest - at if up else at)
    return (np.stack([x, y, height], 1) @ body.turn).astype(np.float32)


def _disc(body: RoundBody, radius: float, height: float, apart: float) -> np.ndarray:
    """Places (M, 3) float32 on a disc across the axis [m]."""
    x, y = _level(body, radius, apart)
    return (np.stack([x, y, np.full(len(x), height)], 1) @ body.turn).astype(np.float32)


def _level(body: RoundBody, radius: float, apart: float) -> np.ndarray:
    """Places (2, M) around the axis, `apart` from each other, up to a radius [m]."""
    along = np.arange(-radius, radius + apart, apart)
    x, y = np.meshgrid(along, along)
    within = np.hypot(x, y) < radius
    return np.stack([x[within] + body.axis[0], y[within] + body.axis[1]])


def _filled(
    body: RoundBody,
    log_odds: np.ndarray,
    corner: np.ndarray,
    spacing: float,
    heights: np.ndarray,
    radius: float,
) -> np.ndarray:
    """The mean log odds (H,) of discs across the axis at heights (H,) [m], no more than LIMIT each."""
    ring = WITHIN * radius * np.sqrt((np.arange(RINGS) + 0.5) / RINGS)
    angle = np.arange(ANGLES) * (2 * np.pi / ANGLES)
    x = body.axis[0] + ring[:, None] * np.cos(angle)
    y = body.axis[1] + ring[:, None] * np.sin(angle)
    places = np.empty((len(heights), RINGS, ANGLES, 3))
    places[..., 0], places[..., 1], places[..., 2] = x, y, heights[:, None, None]
    nodes = (places.reshape(-1, 3) @ body.turn - corner) / spacing
    inside = ((nodes >= 0) & (nodes <= np.array(log_odds.shape) - 1)).all(1)
    odds = np.full(len(nodes), -LIMIT)
    odds[inside] = np.clip(values_at(log_odds, nodes[inside]), -LIMIT, LIMIT)
    return odds.reshape(len(heights), -1).mean(1)


def _put_end(rows: np.ndarray, first: int, radius: int, taper: float, end: float) -> None:
    """Let the body go on from the height `first` down to a flat end [cells], in place, as it tapers, where
    the table (R, Z) does not know; right above the end that is a floor."""
    r, c = np.indices(rows.shape)
    beside = (radius - taper * np.maximum(first - c, 0) - r) / np.hypot(1, taper)
    depth = np.clip(CELL * np.minimum(c - end, beside), EMPTY, DEEP)
    last = int(end) + int(np.ceil(THINNEST / CELL))
    unknown = (rows >= UNKNOWN) & (c <= last)
    rows[unknown] = depth[unknown]
