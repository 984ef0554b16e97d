"""Walls that nobody saw, across tunnels that no ray passed: a mug's bottom, a bowl's wall below its rim.

Knows lattices and readings of a depth image.
"""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled
from reconstruction.surface.field import OUTSIDE, extent
from reconstruction.surface.fusion import PER_METRE, places
from reconstruction.surface.hull_nodes import in_hull
from reconstruction.surface.joint_surface import JointEdges
from reconstruction.surface.neighbours import beside, nodes_off, smoothed
from reconstruction.surface.reading import FAR
from reconstruction.surface.round_body import RoundBody
from reconstruction.surface.seen_surface import Edges
from reconstruction.surface.tunnels import membranes
from reconstruction.surface.vertices_apart import LEAST_VALUE

GRAZED = 0.0015
"""So far into free space [m] a wall may reach: no nearer is a thin wall's place known."""
NEAR, NEAR_GRAZED = 2, 0.004
"""A hole with no place farther than so many nodes from its sides is a slip of the lattice's, and its wall may
reach so far into free space [m]: no better is a whole shape's place known."""
FARTHER = 0.35
"""Log odds that a wall loses with every node of distance from the rest of the object."""
REACH = 8
"""Nodes beyond which distance makes no further difference."""
LEAST = -6.0
"""Log odds below this say no more about where a wall is."""
WITHIN, BESIDE = 3.0, -1.5
"""Log odds in the middle of a wall, and beside it at least: it becomes about 4 mm thick at 2.5 mm a node."""
HELD = 0.3
"""Log odds that hold a wall together where smoothing would open it."""
SMOOTH = 1.0
"""Standard deviation of the smoothing of new walls [nodes]."""
MOST_HIDDEN = 150_000
"""Of more hidden nodes only those nearest to the rest of the object may be of a wall: so many take time."""
OUTSIDE_OF_BODY = -0.004
"""What lies no deeper in a body of revolution [m] is beside it: handles are."""
AROUND = 6
"""Nodes around walls that they change: as far as they are smoothed."""
FEW = 16
"""One node in so many tells whether there are more than that."""
_FAR, _PER_METRE = np.float32(FAR), np.float32(PER_METRE)
_LEAST, _ZERO, _FARTHER = np.float32(LEAST), np.float32(0), np.float32(FARTHER)


def with_unseen_walls(
    log_odds: np.ndarray,
    corner: np.ndarray,
    spacing: float,
    edges: Edges | JointEdges,
    seen: np.ndarray,
    narrow: bool = False,
    vessel: RoundBody | None = None,
) -> np.ndarray | None:
    """The log odds (nx, ny, nz) of one object with walls across tunnels that no ray passed; None without any.

    Lattice at corner + spacing * (i, j, k) [m, table frame]; edges: of the object's image; seen: (N, 3)
    measured points of it [m]; narrow: only across tunnels that are slips of the lattice's; vessel: what the
    object is known to be, if it is one.
    """
    box = extent(log_odds)
    if box is None:
        return None
    # A border of empty nodes, and nothing else beyond the solid: walls lie between its parts.
    first = np.array([part.start for part in box]) - 1
    values = np.full([part.stop - part.start + 2 for part in box], OUTSIDE, np.float32)
    values[1:-1, 1:-1, 1:-1] = log_odds[box]
    solid = values >= LEAST_VALUE  # what is inside by less, marching cubes put outside
    # A wall across a tunnel lies within the solid's hull.
    loose = in_hull(solid) & ~solid
    off = nodes_off(solid)
    if narrow:
        loose &= off <= NEAR
    grazed = NEAR_GRAZED if narrow else GRAZED
    nodes = np.flatnonzero(loose)
    lattice = values.shape, corner + spacing * first, spacing
    if len(nodes) > MOST_HIDDEN:
        few = nodes[::FEW]
        unpassed = ~np.isnan(_unpassed(places(few, *lattice), edges, seen, grazed, vessel))
        if np.count_nonzero(unpassed) > MOST_HIDDEN // FEW:
            nearest = np.sort(off.reshape(-1)[few[unpassed]])
            nodes = nodes[off.reshape(-1)[nodes] < nearest[MOST_HIDDEN // FEW]]
    reach = np.full(values.shape, np.nan, np.float32)
    reach.reshape(-1)[nodes] = _unpassed(places(nodes, *lattice), edges, seen, grazed, vessel)
    wall = membranes(solid, ~np.isnan(reach), _likely(values, off))
    around = extent(wall)
    if around is None:
        return None
    looked_at = tuple(slice(max(s.start - AROUND, 0), s.stop + AROUND) for s in around)
    near_wall, level = wall[looked_at], np.clip(values[looked_at], BESIDE, WITHIN)
    level[~(solid[looked_at] | beside(beside(near_wall)))] = BESIDE
    level[near_wall] = WITHIN
    raised = np.ascontiguousarray(values[looked_at])
    _add_walls(raised, smoothed(level, SMOOTH), near_wall, reach[looked_at])
    values[looked_at] = raised
    result = log_odds.copy()
    result[box] = values[1:-1, 1:-1, 1:-1]
    return result


@compiled
def _likely(values: np.ndarray, off: np.ndarray) -> np.ndarray:
    """How likely a wall is at nodes (nx, ny, nz) with log odds so many nodes off the rest of the object."""
    likely = np.empty_like(values)
    for i in range(len(values)):
        for j in range(values.shape[1]):
            for k in range(values.shape[2]):
                farther = min(max(int(off[i, j, k]) - 1, 0), REACH)
                likely[i, j, k] = min(max(values[i, j, k], _LEAST), _ZERO) - _FARTHER * np.float32(farther)
    return likely


@compiled
def _add_walls(values: np.ndarray, level: np.ndarray, wall: np.ndarray, reach: np.ndarray) -> None:
    """Raise values to a level, no farther than they reach before what was measured: no part of a new wall is
    where rays passed, NaN. All (nx, ny, nz)."""
    nx, ny, nz = values.shape
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if not np.isnan(reach[i, j, k]):
                    new = min(level[i, j, k], reach[i, j, k])
                    if wall[i, j, k]:
                        new = max(new, np.float32(HELD))
                    values[i, j, k] = max(values[i, j, k], new)


def _unpassed(
    points: np.ndarray,
    edges: Edges | JointEdges,
    seen: np.ndarray,
    grazed: float,
    vessel: RoundBody | None,
) -> np.ndarray:
    """How far points (N, 3) [m] are behind what was measured (N,), as log odds; NaN where rays passed more
    than `grazed` [m] before it."""
    if not isinstance(edges, JointEdges):
        reading = edges.read(points)
        _forgive_contents(reading.others, points, vessel)
        return _reach(points, reading.distance, reading.others, *_eye_of(edges, seen), np.float32(grazed))
    # Most places are passed by the first view's rays: no other view is asked about those.
    reach = np.full(len(points), np.nan, np.float32)
    left = np.flatnonzero(edges.above_floor(points[:, 2]) >= -grazed)
    points = points[left]
    readings = np.empty((len(edges.views), 3, len(points)), np.float32)
    for number, view in enumerate(edges.views):
        view.read_into(points, readings[number, :, : len(points)])
        _forgive_contents(readings[number, 2, : len(points)], points, vessel)
        count = _keep_unpassed(points, left, readings[: number + 1], *_eye_of(view, seen), np.float32(grazed))
        points, left = points[:count], left[:count]
    readings = np.ascontiguousarray(readings[:, :, : len(points)])
    reach[left] = np.float32(PER_METRE) * edges.together(points, readings).distance
    return reach


def _forgive_contents(others: np.ndarray, points: np.ndarray, vessel: RoundBody | None) -> None:
    """Let no other object be known to hide points (N, 3) [m] within a vessel: rays that ended on what lies in
    it did not pass its floor. others: (N,) of a reading, changed in place."""
    if vessel is not None:
        others[vessel.depth(points) > OUTSIDE_OF_BODY] = _FAR


def _eye_of(edges: Edges, seen: np.ndarray) -> tuple[np.ndarray, np.float32]:
    """Where a camera is (3,) [m], and how near to it the nearest of seen points (N, 3) is."""
    T = edges.seen.T_camera_table
    eye = (-T[:3, :3].T @ T[:3, 3]).astype(np.float32)
    return eye, np.sqrt(squared_distance(seen, eye).min())


@compiled
def _passed(
    point: np.ndarray, distance: float, others: float, eye: np.ndarray, nearest: float, grazed: float
) -> bool:
    """Whether a ray of one image is known to have passed a point (3,) [m], or the object on its way."""
    if distance < -grazed:
        return True
    # What is seen before the object hides it; what is seen behind it ends rays that passed it on their way to
    # a point. Of points before what is seen, how far from the outline they are tells.
    if not 0 < others < _FAR:
        return False
    x, y, z = point[0] - eye[0], point[1] - eye[1], point[2] - eye[2]
    return bool(np.sqrt(x * x + y * y + z * z) - others > nearest)


@compiled
def _reach(
    points: np.ndarray,
    distance: np.ndarray,
    others: np.ndarray,
    eye: np.ndarray,
    nearest: float,
    grazed: float,
) -> np.ndarray:
    """`_unpassed` of points (N, 3) by a reading of one image (N,)."""
    reach = np.empty(len(points), np.float32)
    for n in range(len(points)):
        passed = _passed(points[n], distance[n], others[n], eye, nearest, grazed)
        reach[n] = np.float32(np.nan) if passed else _PER_METRE * distance[n]
    return reach


@compiled
def _keep_unpassed(
    points: np.ndarray,
    left: np.ndarray,
    readings: np.ndarray,
    eye: np.ndarray,
    nearest: float,
    grazed: float,
) -> int:
    """How many of points (N, 3), with their numbers (N,) and readings (V, 3, >= N), the last of these views
    has not passed, as `_passed`; these are moved to the front."""
    count, last = 0, len(readings) - 1
    for n in range(len(points)):
        if _passed(points[n], readings[last, 0, n], readings[last, 2, n], eye, nearest, grazed):
            continue
        left[count], points[count] = left[n], points[n]
        for view in range(last + 1):
            for part in range(3):
                readings[view, part, count] = readings[view, part, n]
        count += 1
    return count


@compiled
def squared_distance(points: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Of points (N, 3) float32 from a place (3,) float32: (N,) [m^2]."""
    squares = np.empty(len(points), np.float32)
    for i in range(len(points)):
        x, y, z = points[i, 0] - place[0], points[i, 1] - place[1], points[i, 2] - place[2]
        squares[i] = x * x + y * y + z * z
    return squares
