"""The map on regular lattices: a Gaussian is a product over axes, so no exponential a node is needed.

Knows hinge points, widths and weights; knows nothing of classes' meaning or of fitting.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from mapping.errors import DataError
from mapping.kernels import reach
from mapping.lattice_kernels import Columns, add_kernels, padded
from mapping.lattice_products import Axes, Factors, HingeLattice, Window, kernel_table
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

Block = Callable[[Window], torch.Tensor | None]
"""What one group of hinge points anywhere adds to the logits (C, *window); None: nothing."""


class LatticeEvaluator:
    """Phi W + offset on any lattice; made once for a map, then cheap for many blocks.

    hinges: (H, d); gamma: (H,); W: (H, C); offset: (C,).
    """

    def __init__(self, hinges: np.ndarray, gamma: np.ndarray, W: torch.Tensor, offset: torch.Tensor):
        self.offset = offset
        self.dimensions = hinges.shape[1]
        self.groups: list[Columns | HingeLattice | _ScatteredHinges] = []
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
            axes,
            self.offset,
            [group for group in self.groups if isinstance(group, Columns)],
            [group.on(axes) for group in self.groups if isinstance(group, HingeLattice)],
            [group.on(axes) for group in self.groups if isinstance(group, _ScatteredHinges)],
        )


@dataclass(frozen=True)
class MapOnLattice:
    """A map and one lattice: what blocks of it share is worked out once.

    columns: groups of hinge points on lattices, on a processor; lattices: the same elsewhere; scattered:
    groups anywhere.
    """

    axes: list[np.ndarray]
    offset: torch.Tensor
    columns: list[Columns]
    lattices: list[Factors]
    scattered: list[Block]

    def block(self, window: Window, classes: np.ndarray | None = None) -> torch.Tensor:
        """Logits (C, *window) on a part of the lattice, of all classes or some of them."""
        chosen = np.arange(len(self.offset)) if classes is None else np.asarray(classes)
        shape = tuple(part.stop - part.start for part in window)
        out = self._of_products(window, chosen, shape)
        if out is None:
            lines = torch.from_numpy(self._of_columns(window, chosen))[..., : shape[-1]]
            out = lines.movedim(2, 0).reshape(len(chosen), *shape)
        for group in self.scattered:
            part = group(window)
            if part is not None:
                out += part[torch.from_numpy(chosen).to(part.device)]
        return out

    def lines(self, window: Window, classes: np.ndarray) -> np.ndarray:
        """The same of a lattice in space as rows of vectors: (nx, ny, C, nz rounded up to whole vectors)
        float32, of which those past the window mean nothing."""
        if self.columns and not self.scattered:
            return self._of_columns(window, classes)
        logits = self.block(window, classes).movedim(0, 2).cpu().numpy()
        out = np.zeros((*logits.shape[:3], padded(logits.shape[3])), np.float32)
        out[..., : logits.shape[3]] = logits
        return out

    def _of_columns(self, window: Window, classes: np.ndarray) -> np.ndarray:
        """Logits (nx, ny, C, nz rounded up) from compiled loops; with fewer dimensions there is one x, y."""
        along = [axis[part].astype(np.float64) for axis, part in zip(self.axes, window)]
        x, y, z = [np.zeros(1)] * (3 - len(window)) + along
        out = np.empty((len(x), len(y), len(classes), padded(len(z))), np.float32)
        out[:] = self.offset.numpy()[classes, None]
        for group in self.columns:
            add_kernels(group, x, y, z, classes, out, float(reach(group.gamma, CUTOFF)), NEGLIGIBLE)
        return out

    def _of_products(
        self, window: Window, classes: np.ndarray, shape: tuple[int, ...]
    ) -> torch.Tensor | None:
        """Logits (C, *window) from torch's products; None where there are none to be taken."""
        if self.columns or (self.offset.device.type == "cpu" and len(shape) <= 3):
            return None
        chosen = torch.from_numpy(classes).to(self.offset.device)
        offset = self.offset[chosen]
        factors = [found for lattice in self.lattices if (found := lattice(window, chosen)) is not None]
        if not factors:
            return offset.view(-1, *[1] * len(window)).repeat(1, *shape)
        # One product for all groups: the logits are written once.
        tables, lefts = zip(*factors)
        table = torch.cat(tables, 1).expand(len(offset), -1, -1)
        return torch.baddbmm(offset.view(-1, 1, 1), table, torch.cat(lefts, 1)).view(len(offset), *shape)


@dataclass(frozen=True)
class _ScatteredHinges:
    """Hinge points of one width anywhere: hinges (h, d), weights (h, C)."""

    hinges: np.ndarray
    gamma: float
    weights: torch.Tensor

    def on(self, axes: list[np.ndarray]) -> Block:
        """This group's part of any block of a lattice."""

        return lambda window: self._evaluate([axis[w] for axis, w in zip(axes, window)])

    def _evaluate(self, axes: list[np.ndarray]) -> torch.Tensor | None:
        low, high = np.array([a[0] for a in axes]), np.array([a[-1] for a in axes])
        gap = np.maximum(np.maximum(low - self.hinges, self.hinges - high), 0)
        near = np.flatnonzero((gap**2).sum(1) < reach(self.gamma, CUTOFF) ** 2)
        if len(near) == 0:
            return None
        weights = self.weights[torch.from_numpy(near).to(self.weights.device)]
        tables = [
            kernel_table(a, self.hinges[near, i], self.gamma, NEGLIGIBLE).to(weights)
            for i, a in enumerate(axes)
        ]
        # All axes but the last against the last one: a single matrix product.
        left = tables[0]
        for table in tables[1:-1]:
            left = (left[:, None, :] * table[None, :, :]).reshape(-1, len(near))
        right = (weights.T[:, :, None] * tables[-1].T).movedim(0, 1)  # (h, C, n_last)
        block = left @ right.reshape(len(near), -1)
        return block.reshape(*(len(a) for a in axes[:-1]), -1, len(axes[-1])).movedim(-2, 0)


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


def _group(
    hinges: np.ndarray, gamma: float, weights: torch.Tensor
) -> Columns | HingeLattice | _ScatteredHinges:
    found = [np.unique(hinges[:, i], return_inverse=True) for i in range(hinges.shape[1])]
    places = [values for values, _ in found]
    size = [len(values) for values in places]
    if np.prod(size, dtype=float) > LARGEST_FILL * len(hinges):
        return _ScatteredHinges(hinges, gamma, weights)
    cell = np.ravel_multi_index([index.reshape(-1) for _, index in found], size)
    if len(size) <= 3 and weights.device.type == "cpu":
        return Columns.of(places, cell, weights.numpy(), gamma)
    radius = float(reach(gamma, CUTOFF))
    return HingeLattice.of(places, cell, weights, gamma, radius=radius, negligible=NEGLIGIBLE)
