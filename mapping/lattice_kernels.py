"""Gaussian kernels of one width on a lattice, summed up on the nodes of another one.

Knows hinge points on lattices, widths and weights; must not know what a class means or how a map is asked.

A Gaussian is a product over axes. Sums are taken along z first, of the hinge points of one column only, then
along y, then along x: each step works for all hinge points that share what is left of their place, and skips
places without one.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapping.compiled import compiled
from mapping.lanes import LANES, every, load, plus_product, store


class Columns(NamedTuple):
    """Hinge points of one width, in columns along z.

    x, y, z: (mx,), (my,), (mz,) float64 places along the axes, sorted; first: (mx my + 1,) where the hinge
    points of each column (x, y) begin; level: (h,) int32 place along z of each; weights: (h, C) float32.
    """

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    first: np.ndarray
    level: np.ndarray
    weights: np.ndarray
    gamma: float

    @classmethod
    def of(cls, places: list[np.ndarray], cell: np.ndarray, weights: np.ndarray, gamma: float) -> Columns:
        """Of hinge points (h,) in the cells `cell` of a lattice with places (m_1,) .. (m_d,), d at most 3."""
        flat = [np.zeros(1)] * (3 - len(places))
        x, y, z = (axis.astype(np.float64) for axis in (*flat, *places))
        order = np.argsort(cell, kind="stable")
        counts = np.bincount(cell // len(z), minlength=len(x) * len(y))
        level = (cell[order] % len(z)).astype(np.int32)
        return cls(x, y, z, np.append(0, np.cumsum(counts)), level, weights[order], gamma)


def padded(count: int) -> int:
    """The numbers that vectors of `count` numbers take."""
    return -(-count // LANES) * LANES


@compiled
def add_kernels(
    columns: Columns,
    xs: np.ndarray,
    ys: np.ndarray,
    zs: np.ndarray,
    classes: np.ndarray,
    out: np.ndarray,
    radius: float,
    negligible: float,
) -> None:
    """Add the kernels' share of some classes (K,) to out (nx, ny, K, nz padded), in one piece, on the nodes
    of a lattice, xs, ys, zs, which rise. Hinge points farther than `radius` from the block, and values along
    one axis below `negligible`, do not count."""
    gamma, side = columns.gamma, out.shape[3]
    x0, x1 = _in_reach(columns.x, xs, radius)
    y0, y1 = _in_reach(columns.y, ys, radius)
    z0, z1 = _in_reach(columns.z, zs, radius)
    along_x = _table(columns.x[x0:x1], xs, len(xs), gamma, negligible)
    along_y = _table(columns.y[y0:y1], ys, len(ys), gamma, negligible)
    along_z = _table(columns.z[z0:z1], zs, side, gamma, negligible).reshape(-1)
    whole, first, level, weights = out.reshape(-1), columns.first, columns.level, columns.weights
    line = np.empty(len(classes) * side, np.float32)
    plane = np.empty(len(ys) * len(line), np.float32)
    rows = len(columns.y)
    for x in range(x0, x1):
        if first[x * rows + y0] == first[x * rows + y1]:
            continue
        some_in_plane = False
        for y in range(y0, y1):
            some = False
            for h in range(first[x * rows + y], first[x * rows + y + 1]):
                if z0 <= level[h] < z1:
                    if not some:
                        line[:] = 0
                        some = True
                    for k in range(len(classes)):
                        weight, at = every(weights[h, classes[k]]), (level[h] - z0) * side
                        for v in range(0, side, LANES):
                            place = k * side + v
                            store(line, place, plus_product(load(line, place), load(along_z, at + v), weight))
            if some:
                if not some_in_plane:
                    plane[:] = 0
                    some_in_plane = True
                for j in range(len(ys)):
                    if along_y[y - y0, j] > 0:
                        _add(plane, j * len(line), line, along_y[y - y0, j])
        if some_in_plane:
            for i in range(len(xs)):
                if along_x[x - x0, i] > 0:
                    _add(whole, i * len(plane), plane, along_x[x - x0, i])


@compiled
def _add(out: np.ndarray, first: int, part: np.ndarray, factor: float) -> None:
    """Add a part (n,), n a multiple of 8, times a factor to out[first : first + n]."""
    scale = every(factor)
    for v in range(0, len(part), LANES):
        store(out, first + v, plus_product(load(out, first + v), load(part, v), scale))


@compiled
def _in_reach(places: np.ndarray, nodes: np.ndarray, radius: float) -> tuple[int, int]:
    """First and end of the places within `radius` of some nodes, both sorted."""
    return np.searchsorted(places, nodes[0] - radius), np.searchsorted(places, nodes[-1] + radius)


@compiled
def _table(places: np.ndarray, nodes: np.ndarray, side: int, gamma: float, negligible: float) -> np.ndarray:
    """Kernel values (m, side) along one axis, 0 beyond the nodes."""
    table = np.zeros((len(places), side), np.float32)
    for m in range(len(places)):
        for n in range(len(nodes)):
            value = np.exp(-gamma * (nodes[n] - places[m]) ** 2)
            table[m, n] = value if value >= negligible else 0.0
    return table
