"""Lattice nodes that keep what was seen of an object in its mesh. Knows lattices and points only."""

from __future__ import annotations

import numpy as np

CORNERS = np.array(list(np.ndindex(2, 2, 2)))
"""A cell's nodes, seen from its first one."""


def nodes_of_seen_cells(
    values: np.ndarray,
    origin: np.ndarray,
    spacing: float,
    points: np.ndarray,
    surface: float,
    least: float,
    beside: bool = True,
) -> tuple[np.ndarray, ...]:
    """Indices of nodes to take into an object so that no cell with a seen point (N, 3) is without it.

    Things thinner than a cell fall between the nodes of a lattice, and a mesh of them is lace or fragments.
    Where none of a cell's eight nodes has a value above `surface`, the one with the largest is found,
    unless the map rules it out with a value of `least` or below. values: (nx, ny, nz) at origin + spacing *
    (i, j, k) [m]. beside: False where a node above `surface` next to the cell will do as well.
    """
    if min(values.shape) < 2:  # no cell at all
        return tuple(np.empty((values.ndim, 0), int))
    inside, flat = np.ones(len(points), bool), np.zeros(len(points), np.int64)
    for along, start, count in zip(np.ascontiguousarray(points.T), origin, values.shape):
        cell = np.floor((along - start) / spacing).astype(int)
        inside &= (cell >= 0) & (cell < count - 1)
        flat = flat * count + cell
    # Thousands of points lie in hundreds of cells.
    held = np.zeros(values.size, bool)
    held[flat[inside]] = True
    nodes = np.flatnonzero(held)[:, None] + np.ravel_multi_index(tuple(CORNERS.T), values.shape)
    at_nodes = values.reshape(-1)[nodes]
    likeliest = at_nodes.argmax(1)
    rows = np.arange(len(nodes))
    value = at_nodes[rows, likeliest]
    wanted = (least < value) & (value <= surface)
    if not beside:
        wanted[wanted] = ~_any_around(values, nodes[wanted, 0], surface)
    missed = nodes[rows, likeliest][wanted]
    return np.unravel_index(missed, values.shape)


def _any_around(values: np.ndarray, first: np.ndarray, surface: float) -> np.ndarray:
    """Whether any node of cells with first nodes (M,), or next to them, is above `surface`: (M,) bool."""
    steps = np.array(list(np.ndindex(4, 4, 4))) - 1
    index = np.stack(np.unravel_index(first, values.shape), axis=1)[:, None] + steps
    index = np.clip(index, 0, np.array(values.shape) - 1)
    return (values[tuple(np.moveaxis(index, 2, 0))] > surface).any(1)
