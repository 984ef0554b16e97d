"""The map on regular lattices: a Gaussian is a product over axes, so no exponential a node is needed.

Knows hinge points, widths and weights; knows nothing of classes' meaning or of fitting.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from mapping.kernels import reach
from mapping.threads import Threads

CUTOFF = 1e-5
"""Hinge points whose features stay below this in a block are left out."""
BLOCK = 32**3
"""Nodes of the blocks a lattice is evaluated in: 32 a side in space, 181 in the plane. Small blocks see few
hinge points, but each costs some calls."""
LARGEST_FILL = 64
"""Scattered hinge points are not put on a lattice that has more than this many cells a hinge point."""

Axes = Sequence[np.ndarray]


class LatticeEvaluator:
    """Phi W + offset on any lattice; made once for a map, then cheap for many blocks.

    hinges: (H, d); gamma: (H,); W: (H, C); offset: (C,).
    """

    def __init__(self, hinges: np.ndarray, gamma: np.ndarray, W: torch.Tensor, offset: torch.Tensor):
        self.offset = offset
        self.groups: list[_HingeLattice | _ScatteredHinges] = []
        for width in np.unique(gamma):
            rows = np.flatnonzero(gamma == width)
            weights = W[torch.from_numpy(rows).to(W.device)]
            self.groups.append(_group(hinges[rows], float(width), weights))

    def __call__(self, axes: Axes) -> torch.Tensor:
        """Logits (C, *lattice) at every node of the lattice spanned by d coordinate arrays."""
        axes = [np.asarray(axis, np.float32) for axis in axes]
        shape = [len(axis) for axis in axes]
        side = round(BLOCK ** (1 / len(shape)))
        if max(shape) <= side:
            return self._block(axes)
        out = self.offset.new_empty(len(self.offset), *shape)

        def fill(corner: tuple[int, ...]) -> None:
            window = [slice(c * side, (c + 1) * side) for c in corner]
            out[(slice(None), *window)] = self._block([a[w] for a, w in zip(axes, window)])

        with Threads(out.device) as threads:
            threads.map(fill, np.ndindex(*(-(-n // side) for n in shape)))
        return out

    def _block(self, axes: Axes) -> torch.Tensor:
        out = self.offset.view(-1, *[1] * len(axes)).repeat(1, *(len(axis) for axis in axes))
        for group in self.groups:
            part = group.evaluate(axes)
            if part is not None:
                out += part
        return out


@dataclass(frozen=True)
class _HingeLattice:
    """Hinge points of one width on a lattice of their own: contracted axis by axis, 50 times less arithmetic.

    places: coordinates along each axis, sorted; weights: (C, m_1, .., m_d), zero where no hinge point is.
    """

    places: list[np.ndarray]
    gamma: float
    weights: torch.Tensor

    def evaluate(self, axes: Axes) -> torch.Tensor | None:
        radius = float(reach(self.gamma, CUTOFF))
        tensor = self.weights
        tables = []
        for i, (axis, places) in enumerate(zip(axes, self.places)):
            first, last = np.searchsorted(places, [axis[0] - radius, axis[-1] + radius])
            if first == last:
                return None
            tensor = tensor.narrow(i + 1, int(first), int(last - first))
            tables.append(_table(axis, places[first:last], self.gamma).to(tensor))
        for table in tables:
            tensor = torch.tensordot(tensor, table, dims=([1], [1]))  # the finished axis goes last
        return tensor


@dataclass(frozen=True)
class _ScatteredHinges:
    """Hinge points of one width anywhere: hinges (h, d), weights (h, C)."""

    hinges: np.ndarray
    gamma: float
    weights: torch.Tensor

    def evaluate(self, axes: Axes) -> torch.Tensor | None:
        low, high = np.array([a[0] for a in axes]), np.array([a[-1] for a in axes])
        gap = np.maximum(np.maximum(low - self.hinges, self.hinges - high), 0)
        near = np.flatnonzero((gap**2).sum(1) < reach(self.gamma, CUTOFF) ** 2)
        if len(near) == 0:
            return None
        weights = self.weights[torch.from_numpy(near).to(self.weights.device)]
        tables = [_table(a, self.hinges[near, i], self.gamma).to(weights) for i, a in enumerate(axes)]
        # All axes but the last against the last one: a single matrix product.
        left = tables[0]
        for table in tables[1:-1]:
            left = (left[:, None, :] * table[None, :, :]).reshape(-1, len(near))
        right = (weights.T[:, :, None] * tables[-1].T).movedim(0, 1)  # (h, C, n_last)
        block = left @ right.reshape(len(near), -1)
        return block.reshape(*(len(a) for a in axes[:-1]), -1, len(axes[-1])).movedim(-2, 0)


def _group(hinges: np.ndarray, gamma: float, weights: torch.Tensor) -> _HingeLattice | _ScatteredHinges:
    found = [np.unique(hinges[:, i], return_inverse=True) for i in range(hinges.shape[1])]
    places = [values for values, _ in found]
    size = [len(values) for values in places]
    if np.prod(size, dtype=float) > LARGEST_FILL * len(hinges):
        return _ScatteredHinges(hinges, gamma, weights)
    cell = np.ravel_multi_index([index.reshape(-1) for _, index in found], size)
    tensor = weights.new_zeros(weights.shape[1], int(np.prod(size)))
    # Hinge points given twice add up.
    tensor.index_add_(1, torch.from_numpy(cell).to(weights.device), weights.T.contiguous())
    return _HingeLattice(places, gamma, tensor.reshape(-1, *size))


def _table(nodes: np.ndarray, places: np.ndarray, gamma: float) -> torch.Tensor:
    """(n, m) kernel values along one axis."""
    return torch.from_numpy(np.exp(-gamma * (nodes[:, None] - places) ** 2).astype(np.float32))
