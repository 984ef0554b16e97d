"""One object on a lattice without voids and stray parts, and the closed surface around it.

Knows lattices and points only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reconstruction.surface.field import OUTSIDE, Window, extent
from reconstruction.surface.isosurface import Crossed, crossed_cells, isosurface
from reconstruction.surface.parts import drop, label, parts_to_keep
from reconstruction.surface.vertices_apart import apart, off_the_surface


@dataclass(frozen=True)
class ClosedSolid:
    """What lies inside of one closed surface.

    log_odds: (nx, ny, nz) float32, outside on the border; first: (3,) its first node in the lattice it was
    taken from; crossed: the cells that the surface, where log odds cross 0, goes through.
    """

    log_odds: np.ndarray
    first: np.ndarray
    crossed: Crossed

    @classmethod
    def of(
        cls, log_odds: np.ndarray, smallest_part: float, cells: np.ndarray | None = None
    ) -> ClosedSolid | None:
        """The solid in a lattice (nx, ny, nz) float32, which stays as it is; None without any inside.

        Parts smaller than `smallest_part` of the largest are dropped, unless they were seen; cells: (N, 3),
        those of seen points. Voids are filled.
        """
        occupied = extent(log_odds)
        if occupied is None:
            return None
        # Nothing but outside lies beyond: the steps that follow work on the occupied part alone, framed.
        values, first = _framed(log_odds, occupied)
        parts = label(values)
        kept = parts_to_keep(parts, values.shape, smallest_part, None if cells is None else cells - first)
        if len(kept) < len(parts.sizes) - 1:
            drop(values, parts, kept)
            occupied = extent(values)
            assert occupied is not None  # the largest part stays
            x, y, z = (slice(part.start - 1, part.stop + 1) for part in occupied)
            values = np.ascontiguousarray(values[x, y, z])
            first += [x.start, y.start, z.start]
        values = off_the_surface(values)
        crossed = crossed_cells(values)
        return cls(values, first, crossed) if crossed.triangles else None  # else no more than a touch of it

    @property
    def has_tunnel(self) -> bool:
        """Whether a surface of one part has a tunnel: its Euler characteristic is below a sphere's."""
        return self.crossed.vertices - self.crossed.triangles / 2 < 2

    def surface(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices (V, 3), in nodes of the lattice it was taken from, and triangles (F, 3)."""
        vertices, faces = isosurface(self.log_odds, self.crossed)
        return apart(vertices) + self.first, faces


def _framed(log_odds: np.ndarray, part: Window) -> tuple[np.ndarray, np.ndarray]:
    """A part of a lattice with two nodes more on each side, outside beyond the lattice and on the border, and
    its first node (3,)."""
    near = [
        slice(max(along.start - 1, 0), min(along.stop + 1, count))
        for along, count in zip(part, log_odds.shape)
    ]
    inner = log_odds[tuple(near)]
    framed = np.full([count + 2 for count in inner.shape], OUTSIDE, np.float32)
    framed[1:-1, 1:-1, 1:-1] = inner
    return framed, np.array([along.start - 1 for along in near])
