"""Which hinge points are in a point's reach, by arithmetic instead of search, where they lie on lattices.

Knows hinge points and widths; knows nothing of classes or weights.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from mapping.kernels import reach

LARGEST_TABLE = 2**22
"""Cells of a table; with hinge points further apart than this covers, a search is cheaper."""
MOST_CANDIDATES = 4096
"""Nodes of the box around a point's reach. With more, rounding alone makes scattered points look like a
lattice."""
MOST_WIDTHS = 8
"""Each width has a table of its own."""
UNEVEN = 1e-2
"""Coordinates this close to a multiple of a lattice's spacing, in spacings, lie on it."""


@dataclass(frozen=True)
class HingeCells:
    """Hinge points of one width on a lattice, and a table that has a cell for each of its nodes.

    The hinge points in reach of a point lie at its nearest node or at one of M offsets from there.
    low: (d,) the first node; spacing: (d,); shape: (d,) nodes a side, with a rim as wide as the offsets;
    ids: (cells,) int32 index of the hinge point there or -1; steps: (M,) from a cell to its candidates;
    quadratic: (d + 2, M), which turns a point's terms (see `locate`) into -gamma ||x - h||^2 of each;
    reached: (cells,) whether a hinge point is among a cell's candidates.
    """

    low: np.ndarray
    spacing: np.ndarray
    shape: tuple[int, ...]
    ids: torch.Tensor
    steps: torch.Tensor
    quadratic: torch.Tensor
    reached: np.ndarray

    def locate(self, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """For points (N, d): the cell (N,) of the nearest node, -1 where no hinge point is in reach, and the
        terms (N, d + 2): offset from that node, its square, and 1."""
        d = X.shape[1]
        terms = np.ones((len(X), d + 2), np.float32)
        cell = np.zeros(len(X), np.int32)
        inside = np.ones(len(X), bool)
        for i, size in enumerate(self.shape):
            along = X[:, i] - np.float32(self.low[i])
            node = np.rint(along / np.float32(self.spacing[i]))
            terms[:, i] = along - node * np.float32(self.spacing[i])
            inside &= (node >= 0) & (node < size)
            cell = cell * np.int32(size) + np.clip(node, 0, size - 1).astype(np.int32)
        np.einsum("nd,nd->n", terms[:, :d], terms[:, :d], out=terms[:, d])
        return np.where(inside & self.reached[cell], cell, -1), terms

    def candidates(self, cell: torch.Tensor) -> torch.Tensor:
        """Hinge points (n, M) int32 that may be in reach of points in cells (n,) int32; -1: none is there."""
        places = cell[:, None] + self.steps
        # Several times as fast as indexing with a tensor of two dimensions.
        return self.ids.index_select(0, places.view(-1)).view(places.shape)


def hinge_cells(hinges: np.ndarray, gamma: np.ndarray, cutoff: float) -> list[HingeCells] | None:
    """Tables of hinge points (H, d), one a width in gamma (H,); None where they lie on no lattices.

    cutoff: smaller features are out of reach.
    """
    widths = np.unique(gamma)
    if len(widths) > MOST_WIDTHS:
        return None
    found = []
    for width in widths:
        cells = _cells_of_width(hinges, np.flatnonzero(gamma == width), float(width), cutoff)
        if cells is None:
            return None
        found.append(cells)
    return found


def _cells_of_width(hinges: np.ndarray, rows: np.ndarray, gamma: float, cutoff: float) -> HingeCells | None:
    radius = float(reach(gamma, cutoff))
    low, sides, node = [], [], []
    for coordinates in hinges[rows].T.astype(np.float64):
        places = np.unique(coordinates)
        step = float(np.diff(places).min()) if len(places) > 1 else radius
        index = (coordinates - places[0]) / step
        if np.abs(index - np.rint(index)).max() > UNEVEN:
            return None
        low.append(places[0])
        sides.append(step)
        node.append(np.rint(index).astype(np.int64))
    spacing = np.array(sides)
    if np.prod(2 * radius / spacing + 1) > MOST_CANDIDATES:
        return None
    offsets = _offsets_in_reach(spacing, radius)
    rim = offsets.max(0)
    # Two rims: candidates of a node in the first one lie in the second at most.
    index = np.stack(node, 1) + 2 * rim
    shape = tuple(int(n) for n in index.max(0) + 1 + 2 * rim)
    if np.prod(shape, dtype=float) > LARGEST_TABLE:
        return None
    cell = np.ravel_multi_index(tuple(index.T), shape)
    ids = np.full(np.prod(shape), -1, np.int32)
    ids[cell] = rows
    if np.count_nonzero(ids >= 0) < len(rows):
        return None  # several in one place
    strides = np.array([np.prod(shape[i + 1 :], dtype=int) for i in range(len(shape))])
    steps = offsets @ strides
    reached = np.zeros(len(ids), bool)
    reached[cell[:, None] - steps] = True
    along = offsets * spacing
    quadratic = np.vstack([2 * gamma * along.T, np.full(len(along), -gamma), -gamma * (along**2).sum(1)])
    return HingeCells(
        low=np.array(low) - 2 * rim * spacing,
        spacing=spacing,
        shape=shape,
        ids=torch.from_numpy(ids),
        steps=torch.from_numpy(steps.astype(np.int32)),
        quadratic=torch.from_numpy(quadratic.astype(np.float32)),
        reached=reached,
    )


def _offsets_in_reach(spacing: np.ndarray, radius: float) -> np.ndarray:
    """Offsets (M, d) of nodes that can be within `radius` of a point whose nearest node is the one at 0."""
    rim = np.floor(radius / spacing + 0.5).astype(int)
    axes = [np.arange(-n, n + 1) for n in rim]
    offsets = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, len(rim))
    gap = np.maximum(np.abs(offsets) - 0.5, 0) * spacing
    return offsets[(gap**2).sum(1) <= radius**2]
