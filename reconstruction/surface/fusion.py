"""The map and the depth image in one: log odds on a finer lattice near the surface, exact where it was seen.

Distances count as log odds, one per millimetre: free space caps what the map says, a thin shell behind what
was seen raises it, and the map answers everywhere else. Knows lattices and readings of a depth image.
"""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled
from reconstruction.config import FusionConfig
from reconstruction.surface.diagonals import between_diagonals
from reconstruction.surface.field import extent
from reconstruction.surface.joint_surface import JointEdges
from reconstruction.surface.neighbours import beside, closed, range_in_cells
from reconstruction.surface.refined import interpolated, nodes_of_cells, spread
from reconstruction.surface.seen_cells import cells_with, nodes_of_seen_cells
from reconstruction.surface.seen_surface import Edges
from reconstruction.surface.whole_shape import WholeShape

PER_METRE = 1000.0
"""Log odds a metre of distance."""
LIMIT = 8.0
"""Log odds beyond this say no more."""
NEAR = 3.0
"""A seen surface is no farther than this from the nodes of its cells, as log odds."""
THIN = 0.4
"""Log odds of nodes that keep things thinner than a cell whole."""
RULED_OUT = -2.0
"""Nodes so far in free space, as log odds, are not taken to keep a thin thing whole."""
_PER_METRE, _LIMIT = np.float32(PER_METRE), np.float32(LIMIT)


def fuse(
    log_odds: np.ndarray,
    corner: np.ndarray,
    spacing: float,
    edges: Edges | JointEdges | WholeShape,
    points: np.ndarray,
    config: FusionConfig,
) -> tuple[np.ndarray, np.ndarray]:
    """Fused log odds on a lattice `refine` times as fine that holds all of the object, and the place (3,) of
    its first node, in nodes of the given lattice.

    log_odds: (nx, ny, nz) of the map at corner + spacing * (i, j, k) [m, table frame], two nodes or more an
    axis; edges: of the object's image; points: (N, 3) seen of it [m].
    """
    within = np.concatenate([points, edges.behind(points, config.wall)])
    seen_cells = cells_with(within, corner, spacing, log_odds.shape)
    possible = log_odds > 0
    possible[:-1, :-1, :-1] |= seen_cells
    # Nothing of the object lies elsewhere.
    box, start = _box_of(possible)
    log_odds, seen_cells, possible = log_odds[box], _cells_of(seen_cells, box), beside(possible[box])
    corner = corner + spacing * start
    nodes = np.flatnonzero(possible)
    raised = np.clip(log_odds, -LIMIT, LIMIT)
    at_nodes = raised.reshape(-1)[nodes]
    at_nodes, cap, unknown = _read(at_nodes, nodes, raised.shape, corner, spacing, edges, config)
    raised.reshape(-1)[nodes] = at_nodes
    # Holes of up to two cells in what nobody saw are the map's noise.
    at_nodes = np.where(unknown, closed(raised).reshape(-1)[nodes], at_nodes)
    raised.reshape(-1)[nodes] = at_nodes
    fused = raised.copy()
    fused.reshape(-1)[nodes] = np.minimum(at_nodes, cap)
    # The surface crosses a cell between nodes of both signs, or slips between those of cells near what was
    # seen; not where all nodes are far from it.
    lowest, highest = range_in_cells(fused)
    active = (lowest <= 0) & (highest > 0)
    active |= seen_cells & (lowest < NEAR) & (highest > -NEAR)
    nodes = nodes_of_cells(active, config.refine)
    # Elsewhere only the sign counts: that of a node of the cell.
    values = spread(fused, config.refine)
    fine_spacing = spacing / config.refine
    odds = interpolated(raised, config.refine, nodes)
    odds, cap, _ = _read(odds, nodes, values.shape, corner, fine_spacing, edges, config)
    values.reshape(-1)[nodes] = np.minimum(odds, cap)
    kept = nodes_of_seen_cells(values, corner, fine_spacing, points, 0.0, RULED_OUT, beside=False)
    above = PER_METRE * edges.above_floor((corner[2] + fine_spacing * kept[2]).astype(np.float32))
    values[kept] = np.maximum(values[kept], np.minimum(above, THIN))
    joints = between_diagonals(values, RULED_OUT)
    above = PER_METRE * edges.above_floor((corner[2] + fine_spacing * joints[2]).astype(np.float32))
    values[joints] = np.maximum(values[joints], np.minimum(above, THIN))
    return values, start


def _read(
    odds: np.ndarray,
    nodes: np.ndarray,
    shape: tuple[int, ...],
    corner: np.ndarray,
    spacing: float,
    edges: Edges | JointEdges | WholeShape,
    config: FusionConfig,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """At flat nodes (M,) of a lattice: log odds (M,) raised by what was seen, the cap, and who nobody saw."""
    reading = edges.read(places(nodes, shape, corner, spacing))
    return _combined(odds, *reading, np.float32(config.wall))


@compiled
def _combined(
    odds: np.ndarray, distance: np.ndarray, depth: np.ndarray, others: np.ndarray, wall: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The three arrays of `_read` from log odds and the arrays of a reading, (M,) float32 each."""
    raised, cap = np.empty_like(odds), np.empty_like(odds)
    unknown = np.empty(len(odds), np.bool_)
    for i in range(len(odds)):
        value = max(odds[i], _PER_METRE * (wall - depth[i]))
        theirs = _PER_METRE * (others[i] - wall)
        if others[i] > 0 and theirs < 0:  # what was seen of another object is that object's
            value = min(value, theirs)
        unknown[i] = distance[i] > 0 and depth[i] > wall and theirs > 0
        raised[i] = min(max(value, -_LIMIT), _LIMIT)
        cap[i] = min(max(_PER_METRE * distance[i], -_LIMIT), _LIMIT)
    return raised, cap, unknown


def places(nodes: np.ndarray, shape: tuple[int, ...], corner: np.ndarray, spacing: float) -> np.ndarray:
    """Where flat nodes (M,) of a lattice are, given in ascending order: (M, 3) float32 [m]."""
    _, ny, nz = shape
    return _places(nodes, ny, nz, corner.astype(np.float32), np.float32(spacing))


@compiled
def _places(nodes: np.ndarray, ny: int, nz: int, corner: np.ndarray, spacing: float) -> np.ndarray:
    points = np.empty((len(nodes), 3), np.float32)
    i, j, first = 0, -1, -nz  # the row, and its first node: divisions would take most of the time
    x = y = np.float32(0)
    for m in range(len(nodes)):
        if nodes[m] >= first + nz:
            while nodes[m] >= first + nz:
                first += nz
                j += 1
            i, j = i + j // ny, j % ny
            x, y = np.float32(i) * spacing + corner[0], np.float32(j) * spacing + corner[1]
        points[m, 0], points[m, 1] = x, y
        points[m, 2] = np.float32(nodes[m] - first) * spacing + corner[2]
    return points


def _box_of(nodes: np.ndarray) -> tuple[tuple[slice, ...], np.ndarray]:
    """The part of a lattice that holds all of some nodes and, where there are any, two more on each side; and
    its first node (3,)."""
    ends = [
        slice(max(part.start - 2, 0), min(max(part.stop + 2, 2), count))
        for part, count in zip(extent(nodes) or (slice(0, 1),) * 3, nodes.shape)
    ]
    return tuple(ends), np.array([part.start for part in ends])


def _cells_of(cells: np.ndarray, box: tuple[slice, ...]) -> np.ndarray:
    """The cells between the nodes of a part of a lattice."""
    return cells[tuple(slice(part.start, part.stop - 1) for part in box)]
