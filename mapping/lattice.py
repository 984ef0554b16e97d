"""The map on regular lattices: a Gaussian is a product over axes, so no exponential a node is needed.

Knows hinge points, widths and weights; knows nothing of classes' meaning or of fitting.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from mapping.errors import DataError
from mapping.kernels import reach
from mapping.threads import Threads

CUTOFF = 1e-5
"""Hinge points whose features stay below this in a block are left out."""
BLOCK = 32**3
"""Nodes of the blocks a lattice is evaluated in: 32 a side in space, 181 in the plane. Small blocks see few
hinge points, but each costs some calls."""
NEGLIGIBLE = 1e-7
"""Kernel values along one axis below this count as zero: products of smaller ones leave float32's normal
range, where arithmetic is a hundred times slower."""
LARGEST_FILL = 256
"""Scattered hinge points are not put on a lattice that has more than this many cells a hinge point."""

Axes = Sequence[np.ndarray]
Window = tuple[slice, ...]
Block = Callable[[Window, torch.Tensor | None], torch.Tensor | None]
"""What one group of hinge points adds to the logits (C, *window) of some classes; None: nothing."""
Factors = Callable[[Window, torch.Tensor | None], tuple[torch.Tensor, torch.Tensor] | None]
"""The same as a product yet to be taken: (n_1, m) times (C, m, n_2 n_3 ..)."""


class LatticeEvaluator:
    """Phi W + offset on any lattice; made once for a map, then cheap for many blocks.

    hinges: (H, d); gamma: (H,); W: (H, C); offset: (C,).
    """

    def __init__(self, hinges: np.ndarray, gamma: np.ndarray, W: torch.Tensor, offset: torch.Tensor):
        self.offset = offset
        self.dimensions = hinges.shape[1]
        self.groups: list[_HingeLattice | _ScatteredHinges] = []
        for width in np.unique(gamma):
            rows = np.flatnonzero(gamma == width)
            weights = W[torch.from_numpy(rows).to(W.device)]
            self.groups.append(_group(hinges[rows], float(width), weights))

    def __call__(self, axes: Axes) -> torch.Tensor:
        """Logits (C, *lattice) at every node of the lattice spanned by d coordinate arrays, in their order:
        they may rise, fall or jump. Raises DataError when they are not d arrays (n,) of numbers."""
        axes = _checked(axes, self.dimensions)
        shape = [len(axis) for axis in axes]
        if 0 in shape:
            return self.offset.new_empty(len(self.offset), *shape)
        orders = [None if rises(axis) else np.argsort(axis, kind="stable") for axis in axes]
        if any(order is not None for order in orders):
            out = self([axis if order is None else axis[order] for axis, order in zip(axes, orders)])
            for i, order in enumerate(orders):
                if order is not None:
                    places = torch.from_numpy(np.argsort(order)).to(out.device)
                    out = out.index_select(i + 1, places)
            return out
        side = round(BLOCK ** (1 / len(shape)))
        lattice = self.on(axes)
        if max(shape) <= side:
            return lattice.block(tuple(slice(0, n) for n in shape))
        out = self.offset.new_empty(len(self.offset), *shape)

        def fill(corner: tuple[int, ...]) -> None:
            window = tuple(slice(c * side, min((c + 1) * side, n)) for c, n in zip(corner, shape))
            out[(slice(None), *window)] = lattice.block(window)

        with Threads(out.device) as threads:
            threads.map(fill, np.ndindex(*(-(-n // side) for n in shape)))
        return out

    def share(self, axes: Axes, column: int, known: int) -> np.ndarray:
        """P(class `column`) float32 among the first `known` classes, at every node: (*lattice)."""
        return torch.softmax(self(axes)[:known], 0)[column].cpu().numpy()

    def largest(self, axes: Axes) -> np.ndarray:
        """The class (*lattice) with the largest logit at every node."""
        return self(axes).argmax(0).cpu().numpy()

    def on(self, axes: Axes) -> MapOnLattice:
        """The map on the lattice spanned by d coordinate arrays that rise, to be asked block by block."""
        axes = _checked(axes, self.dimensions)
        if not all(rises(axis) for axis in axes):
            raise DataError("the coordinates of a lattice's axes must rise")
        return MapOnLattice(
            self.offset,
            [group.on(axes) for group in self.groups if isinstance(group, _HingeLattice)],
            [group.on(axes) for group in self.groups if isinstance(group, _ScatteredHinges)],
        )


@dataclass(frozen=True)
class MapOnLattice:
    """A map and one lattice: what blocks of it share is worked out once."""

    offset: torch.Tensor
    lattices: list[Factors]
    scattered: list[Block]

    def block(self, window: Window, classes: torch.Tensor | None = None) -> torch.Tensor:
        """Logits (C, *window) on a part of the lattice, of all classes or some of them."""
        offset = self.offset if classes is None else self.offset[classes]
        shape = len(offset), *(part.stop - part.start for part in window)
        factors = [found for lattice in self.lattices if (found := lattice(window, classes)) is not None]
        if factors:
            # One product for all groups: the logits are written once.
            tables, lefts = zip(*factors)
            table = torch.cat(tables, 1).expand(len(offset), -1, -1)
            out = torch.baddbmm(offset.view(-1, 1, 1), table, torch.cat(lefts, 1)).view(shape)
        else:
            out = offset.view(-1, *[1] * len(window)).repeat(1, *shape[1:])
        for group in self.scattered:
            part = group(window, classes)
            if part is not None:
                out += part
        return out


@dataclass(frozen=True)
class _HingeLattice:
    """Hinge points of one width on a lattice of their own: contracted axis by axis, 50 times less arithmetic.

    places: coordinates along each axis, sorted; weights: (C, m_1, .., m_d), zero where no hinge point is;
    held: (m_1, .., m_d) bool, where one is.
    """

    places: list[np.ndarray]
    gamma: float
    weights: torch.Tensor
    held: np.ndarray

    def on(self, axes: Axes) -> Factors:
        """This group's part of any block of a lattice."""
        radius = float(reach(self.gamma, CUTOFF))
        known: dict[tuple[int, int, int], tuple[int, torch.Tensor]] = {}

        def along(i: int, part: slice) -> tuple[int, torch.Tensor]:
            """First hinge place in reach of some nodes of axis i, and the kernel values (n, m) from there."""
            key = i, part.start, part.stop
            if key not in known:
                nodes, places = axes[i][part], self.places[i]
                first, last = np.searchsorted(places, [nodes[0] - radius, nodes[-1] + radius])
                table = kernel_table(nodes, places[first:last], self.gamma).to(self.weights)
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


@dataclass(frozen=True)
class _ScatteredHinges:
    """Hinge points of one width anywhere: hinges (h, d), weights (h, C)."""

    hinges: np.ndarray
    gamma: float
    weights: torch.Tensor

    def on(self, axes: Axes) -> Block:
        """This group's part of any block of a lattice."""

        def block(window: Window, classes: torch.Tensor | None) -> torch.Tensor | None:
            part = self._evaluate([axis[w] for axis, w in zip(axes, window)])
            return part if part is None or classes is None else part[classes]

        return block

    def _evaluate(self, axes: Axes) -> torch.Tensor | None:
        low, high = np.array([a[0] for a in axes]), np.array([a[-1] for a in axes])
        gap = np.maximum(np.maximum(low - self.hinges, self.hinges - high), 0)
        near = np.flatnonzero((gap**2).sum(1) < reach(self.gamma, CUTOFF) ** 2)
        if len(near) == 0:
            return None
        weights = self.weights[torch.from_numpy(near).to(self.weights.device)]
        tables = [kernel_table(a, self.hinges[near, i], self.gamma).to(weights) for i, a in enumerate(axes)]
        # All axes but the last against the last one: a single matrix product.
        left = tables[0]
        for table in tables[1:-1]:
            left = (left[:, None, :] * table[None, :, :]).reshape(-1, len(near))
        right = (weights.T[:, :, None] * tables[-1].T).movedim(0, 1)  # (h, C, n_last)
        block = left @ right.reshape(len(near), -1)
        return block.reshape(*(len(a) for a in axes[:-1]), -1, len(axes[-1])).movedim(-2, 0)


def _box_of(held: np.ndarray) -> Window | None:
    """The smallest window of a lattice that has all places (m_1, .., m_d) that hold something."""
    axes = range(held.ndim)
    along = [np.flatnonzero(held.any(tuple(j for j in axes if j != i))) for i in axes]
    return tuple(slice(n[0], n[-1] + 1) for n in along) if len(along[0]) else None


def rises(axis: np.ndarray) -> bool:
    """Whether no coordinate is smaller than the one before."""
    return bool((axis[1:] >= axis[:-1]).all())


def _checked(axes: Axes, dimensions: int) -> list[np.ndarray]:
    try:
        arrays = [np.asarray(axis, np.float32) for axis in axes]
    except (TypeError, ValueError) as error:
        raise DataError(f"a lattice's axes must be arrays (n,) of numbers ({error})") from error
    if len(arrays) != dimensions or any(axis.ndim != 1 for axis in arrays):
        raise DataError(
            f"a lattice needs {dimensions} axes, arrays (n,) of coordinates; got shapes "
            f"{[axis.shape for axis in arrays]}"
        )
    if not all(np.isfinite(axis).all() for axis in arrays):
        raise DataError("a lattice's axes hold NaN or infinite values")
    return arrays


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
    held = np.zeros(size, bool)
    held.reshape(-1)[cell] = True
    return _HingeLattice(places, gamma, tensor.reshape(-1, *size), held)


def kernel_table(nodes: np.ndarray, places: np.ndarray, gamma: float) -> torch.Tensor:
    """(n, m) kernel values along one axis."""
    values = np.exp(-gamma * (nodes[:, None] - places) ** 2).astype(np.float32)
    values[values < NEGLIGIBLE] = 0
    return torch.from_numpy(values)
