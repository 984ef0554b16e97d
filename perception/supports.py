"""Supports in the plural: boards of a shelf, a tray on a table, a table and the floor.

Knows measured points, labels and the support plane that was found first; knows nothing of shapes. Further
supports are parallel to the first one: what is level in one place is level everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapping.compiled import compiled
from perception.camera import Camera
from perception.config import PerceptionConfig
from perception.observation import SupportPlane
from perception.quantiles import quantiles

CELL = 0.012
"""Level surfaces are looked for in cells of the image about this wide [m]."""
FILLED = 0.6
"""Share of a cell's pixels that must be measured and unlabelled."""
LEVEL_SLOPE = 0.2
"""Neighbouring cells of a level surface differ in height by less than this share of their distance."""
LEAST_AREA = 0.003
"""A further support shows at least this much of its surface [m^2]."""
MOST_LEVELS = 8
"""Level surfaces looked at, the largest first."""
BIN = 0.004
"""Bins of the histogram of heights [m]."""
HALF_THICKNESS = 0.008
"""Cells within this height of a level belong to it, more at long range [m]."""
BESIDE = 0.05
"""A support is seen within this horizontal distance of what stands on it [m]."""
REST_GAP = 0.02
"""What begins within this height above a level rests on it [m]."""
SUNK_SHARE = 0.1
"""Masks bleed: up to this share of an object's points may lie under its support."""
OBJECT_POINTS = 400
"""Points of an object that are compared with the levels."""
FIRST_SUPPORT = 2
"""Where an object's foot is hidden, the first support counts this many times."""
LEAST_CELLS = 3
"""A level is beside an object when at least this many of its cells are."""


@dataclass(frozen=True)
class Levels:
    """Heights [m] over the first support plane: of all supports that carry something, and under each label.

    heights: ascending, the first support's 0 among them. floors: label -> height of the level it stands on;
    found: labels whose support is seen beside them; the others are taken to stand on the first one.
    """

    heights: tuple[float, ...]
    floors: dict[int, float]
    found: frozenset[int]


def find_levels(
    points: np.ndarray,
    labels: np.ndarray,
    measured: dict[int, np.ndarray],
    support: SupportPlane,
    camera: Camera,
    config: PerceptionConfig,
) -> Levels:
    """Which level each labelled object stands on.

    points: (H, W, 3) float32 [m] in the camera frame, NaN where missing. labels: (H, W), as given. measured:
    label -> flat indices of its measured pixels.
    """
    cells, height = _level_cells(points, labels, support, camera, config)
    levels = _levels(cells, height, config)
    axes = np.linalg.svd(support.normal[None])[2][1:]  # two directions along the plane
    flat = axes @ cells.T
    floors: dict[int, float] = {}
    found: set[int] = set()
    for label, pixels in measured.items():
        own = points.reshape(-1, 3)[pixels[:: 1 + len(pixels) // OBJECT_POINTS]].astype(np.float64)
        own_height = own @ support.normal + support.offset
        level = _level_under(axes @ own.T, own_height, levels, flat, height)
        if level is not None:
            found.add(label)
        elif np.mean(own_height < -HALF_THICKNESS) > 1 - SUNK_SHARE:
            level = float(quantiles(own_height, 0.02)[0])  # under every level that is seen: its own foot
        floors[label] = 0.0 if level is None else level
    return Levels(tuple(sorted({0.0, *floors.values()})), floors, frozenset(found))


def _level_cells(
    points: np.ndarray, labels: np.ndarray, support: SupportPlane, camera: Camera, config: PerceptionConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Centres (M, 3) [m] and heights (M,) [m] of the image's cells that see a level surface, unlabelled."""
    depth = points[..., 2]
    middle = float(np.nanmedian(depth[::4, ::4]))
    side = max(2, round(CELL * float(camera.K[0, 0]) / middle)) if np.isfinite(middle) else 2
    rows, columns = depth.shape[0] // side, depth.shape[1] // side
    if rows < 2 or columns < 2:
        return np.empty((0, 3)), np.empty(0)
    total, count = _cell_sums(points, labels, side, rows, columns)
    centre = total / np.maximum(count, 1)[..., None]
    centre[count * np.float32(1 / side**2) < FILLED] = np.nan
    height = centre @ support.normal + support.offset
    level = np.ones((rows, columns), bool)
    for axis in (0, 1):
        step = np.linalg.norm(np.diff(centre, axis=axis), axis=2)
        with np.errstate(invalid="ignore"):
            flat = np.abs(np.diff(height, axis=axis)) < LEVEL_SLOPE * step
        pad = [(0, 0), (0, 0)]
        pad[axis] = (1, 1)
        beside = np.pad(flat, pad)
        # Level towards one neighbour at least, along both directions of the image.
        level &= beside[1:] | beside[:-1] if axis == 0 else beside[:, 1:] | beside[:, :-1]
    return centre[level], height[level]


@compiled
def _cell_sums(
    points: np.ndarray, labels: np.ndarray, side: int, rows: int, columns: int
) -> tuple[np.ndarray, np.ndarray]:
    """Sum (rows, columns, 3) and count (rows, columns) of the measured, unlabelled points in square cells."""
    total, count = np.zeros((rows, columns, 3)), np.zeros((rows, columns), np.float32)
    for row in range(rows * side):
        for column in range(columns):
            x, y, z, number = 0.0, 0.0, 0.0, 0
            for pixel in range(column * side, (column + 1) * side):
                if labels[row, pixel] == 0 and not np.isnan(points[row, pixel, 2]):
                    x += points[row, pixel, 0]
                    y += points[row, pixel, 1]
                    z += points[row, pixel, 2]
                    number += 1
            cell = total[row // side, column]
            cell[0], cell[1], cell[2] = cell[0] + x, cell[1] + y, cell[2] + z
            count[row // side, column] += number
    return total, count


def _levels(cells: np.ndarray, height: np.ndarray, config: PerceptionConfig) -> list[float]:
    """Heights [m] where much level surface lies, the first support's 0 always among them."""
    found = [0.0]
    near = np.abs(height) < _thickness(cells, config)
    cells, height = cells[~near], height[~near]
    for _ in range(MOST_LEVELS):
        if len(height) * CELL**2 < LEAST_AREA:
            break
        number = np.floor((height - height.min()) / BIN).astype(int)
        crowd = np.convolve(np.bincount(number), np.ones(3), "same")
        middle = height.min() + BIN * (int(crowd.argmax()) + 0.5)
        inside = np.abs(height - middle) < _thickness(cells, config)
        if inside.sum() * CELL**2 < LEAST_AREA:
            break
        found.append(float(np.median(height[inside])))
        cells, height = cells[~inside], height[~inside]
    return found


def _thickness(cells: np.ndarray, config: PerceptionConfig) -> np.ndarray:
    """How far from a level its cells may lie (M,) [m]."""
    return HALF_THICKNESS + config.depth_noise * cells[:, 2] ** 2


def _level_under(
    own: np.ndarray, own_height: np.ndarray, levels: list[float], flat: np.ndarray, height: np.ndarray
) -> float | None:
    """The level that an object with points own (2, N) along the plane stands on, or None. flat (2, M) and
    height (M,): the level cells.

    It rests on the highest one that it begins at; where its foot is hidden, the one most of which is seen
    beside it, and on several sides of it if it is a raised one: the top of a box that hides the foot is no
    support.
    """
    beside = np.ones(len(height), bool)
    for cells_along, own_along in zip(flat, own):
        beside &= (cells_along > own_along.min() - BESIDE) & (cells_along < own_along.max() + BESIDE)
    flat, height = flat[:, beside], height[beside]
    resting: list[tuple[float, int]] = []
    hidden: list[tuple[float, int]] = []
    for level in levels:
        sunk = own_height < level - HALF_THICKNESS
        at_level = np.abs(height - level) < 2 * HALF_THICKNESS
        cells = int(at_level.sum())
        if cells < LEAST_CELLS or sunk.mean() > SUNK_SHARE:
            continue
        gap = float(quantiles(own_height[~sunk], 0.03)[0]) - level
        if gap < REST_GAP:
            resting.append((level, cells))
        elif level <= 0 or _around(np.median(own, axis=1), flat[:, at_level].T):
            hidden.append((level, cells))
    if resting:
        return max(resting)[0]
    # The first support carries most things: another one must be seen much more of to be preferred.
    weighted = [(cells if level else FIRST_SUPPORT * cells, level) for level, cells in hidden]
    return max(weighted)[1] if weighted else None


def _around(place: np.ndarray, cells: np.ndarray) -> bool:
    """Whether a place (2,) lies within the hull of cells (M, 2)."""
    import cv2

    hull = cv2.convexHull(cells.astype(np.float32))
    return bool(cv2.pointPolygonTest(hull, (float(place[0]), float(place[1])), False) > 0)
