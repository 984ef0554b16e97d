"""Gaussian kernels of one width on a lattice, summed up on the nodes of another one, by torch's products.

Knows hinge points on lattices, widths and weights; must not know what a class means or how a map is asked.
For any device and any number of dimensions; on a processor, mapping.lattice_kernels takes less time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

Axes = Sequence[np.ndarray]
Window = tuple[slice, ...]
Factors = Callable[[Window, torch.Tensor | None], tuple[torch.Tensor, torch.Tensor] | None]
"""What one group of hinge points adds to some classes on a window, as a product yet to be taken: (n_1, m)
times (C, m, n_2 n_3 ..); None: nothing."""


@dataclass(frozen=True)
class HingeLattice:
    """Hinge points of one width on a lattice of their own: contracted axis by axis, 50 times less arithmetic.

    places: coordinates along each axis, sorted; weights: (C, m_1, .., m_d), zero where no hinge point is;
    held: (m_1, .., m_d) bool, where one is; radius: farther hinge points do not count; negligible: nor do
    kernel values along one axis below this.
    """

    places: list[np.ndarray]
    gamma: float
    weights: torch.Tensor
    held: np.ndarray
    radius: float
    negligible: float

    @classmethod
    def of(
        cls, places: list[np.ndarray], cell: np.ndarray, weights: torch.Tensor, gamma: float, **bounds: float
    ) -> HingeLattice:
        """Of hinge points (h,) in the cells `cell` of a lattice with places (m_1,) .. (m_d,)."""
        size = [len(along) for along in places]
        tensor = weights.new_zeros(weights.shape[1], int(np.prod(size)))
        # Hinge points given twice add up.
        tensor.index_add_(1, torch.from_numpy(cell).to(weights.device), weights.T.contiguous())
        held = np.zeros(size, bool)
        held.reshape(-1)[cell] = True
        return cls(places, gamma, tensor.reshape(-1, *size), held, **bounds)

    def on(self, axes: Axes) -> Factors:
        """This group's part of any block of a lattice."""
        known: dict[tuple[int, int, int], tuple[int, torch.Tensor]] = {}

        def along(i: int, part: slice) -> tuple[int, torch.Tensor]:
            """First hinge place in reach of some nodes of axis i, and the kernel values (n, m) from there."""
            key = i, part.start, part.stop
            if key not in known:
                nodes, places = axes[i][part], self.places[i]
                first, last = np.searchsorted(places, [nodes[0] - self.radius, nodes[-1] + self.radius])
                table = kernel_table(nodes, places[first:last], self.gamma, self.negligible).to(self.weights)
                known[key] = int(first), table
            return known[key]

        def block(window: Window, classes: torch.Tensor | None) -> tuple[torch.Tensor, torch.Tensor] | None:
            near = [along(i, part) for i, part in enumerate(window)]
            # Most of the lattice holds no hinge point: only the box around those in reach is contracted.
            box = _box_of(self.held[tuple(slice(first, first + table.shape[1]) for first, table in near)])
            if box is None:
                return None
            tensor, tables = self.weights, []
            for i, ((first, table), part) in enumerate(zip(near, box)):
                tensor = tensor.narrow(i + 1, first + part.start, part.stop - part.start)
                tables.append(table[:, part])
            if classes is not None:
                tensor = tensor.index_select(0, classes)
            count, after = len(tensor), 1
            if len(tables) > 1:
                tensor, after = tensor @ tables[-1].T, len(tables[-1])
            for table in reversed(tables[1:-1]):
                # What is left of the axes before x this axis x nodes of the axes after it: nothing is copied.
                left = tensor.reshape(-1, table.shape[1], after)
                tensor, after = torch.bmm(table.expand(len(left), -1, -1), left), after * len(table)
            return tables[0], tensor.reshape(count, tables[0].shape[1], after)

        return block


def _box_of(held: np.ndarray) -> Window | None:
    """The smallest window of a lattice that has all places (m_1, .., m_d) that hold something."""
    axes = range(held.ndim)
    along = [np.flatnonzero(held.any(tuple(j for j in axes if j != i))) for i in axes]
    return tuple(slice(n[0], n[-1] + 1) for n in along) if len(along[0]) else None


def kernel_table(nodes: np.ndarray, places: np.ndarray, gamma: float, negligible: float) -> torch.Tensor:
    """(n, m) kernel values along one axis."""
    values = np.exp(-gamma * (nodes[:, None] - places) ** 2).astype(np.float32)
    values[values < negligible] = 0
    return torch.from_numpy(values)
