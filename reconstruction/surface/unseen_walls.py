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
AROUND = 6
"""Nodes around walls that they change: as far as they are smoothed."""
FEW = 16
"""One node in so many tells whether there are more than that."""
_PER_METRE = np.float32(PER_METRE)
_LEAST, _ZERO, _FARTHER = np.float32(LEAST), np.float32(0), np.float32(FARTHER)


def with_unseen_walls(
    log_odds: np.ndarray,
    corner: np.ndarray,
    spacing: float,
    edges: Edges | JointEdges,
    narrow: bool = False,
) -> np.ndarray | None:
    """The log odds (nx, ny, nz) of one object with walls across tunnels that no ray passed; None without any.

    Lattice at corner + spacing * (i, j, k) [m, table frame]; edges: of the object's image; narrow: only
    across tunnels that are slips of the lattice's.
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
        unpassed = ~np.isnan(_unpassed(places(few, *lattice), edges, grazed))
        if np.count_nonzero(unpassed) > MOST_HIDDEN // FEW:
            nearest = np.sort(off.reshape(-1)[few[unpassed]])
            nodes = nodes[off.reshape(-1)[nodes] < nearest[MOST_HIDDEN // FEW]]
    reach = np.full(values.shape, np.nan, np.float32)
    reach.reshape(-1)[nodes] = _unpassed(places(nodes, *lattice), edges, grazed)
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


def _unpassed(points: np.ndarray, edges: Edges | JointEdges, grazed: float) -> np.ndarray:
    """How far points (N, 3) [m] are behind what was measured (N,), as log odds; NaN where rays passed more
    than `grazed` [m] before it. What another object hides, no ray passed: a bowl's floor below its fruit."""
    if not isinstance(edges, JointEdges):
        distance = edges.read(points).distance
        return np.where(distance < -grazed, np.float32(np.nan), _PER_METRE * distance)
    # Most places are passed by the first view's rays: no other view is asked about those.
    reach = np.full(len(points), np.nan, np.float32)
    left = np.flatnonzero(edges.above_floor(points[:, 2]) >= -grazed)
    points = points[left]
    readings = np.empty((len(edges.views), 3, len(points)), np.float32)
    for number, view in enumerate(edges.views):
        view.read_into(points, readings[number, :, : len(points)])
        count = _keep_unpassed(points, left, readings[: number + 1], np.float32(grazed))
        points, left = points[:count], left[:count]
    readings = np.ascontiguousarray(readings[:, :, : len(points)])
    reach[left] = np.float32(PER_METRE) * edges.together(points, readings).distance
    return reach


@compiled
def _keep_unpassed(points: np.ndarray, left: np.ndarray, readings: np.ndarray, grazed: float) -> int:
    """How many of points (N, 3), with their numbers (N,) and readings (V, 3, >= N), the last of these views
    has not passed; these are moved to the front."""
    count, last = 0, len(readings) - 1
    for n in range(len(points)):
        if readings[last, 0, n] < -grazed:
            continue
        left[count], points[count] = left[n], points[n]
        for view in range(last + 1):
            for part in range(3):
                readings[view, part, count] = readings[view, part, n]
        count += 1
    return count
