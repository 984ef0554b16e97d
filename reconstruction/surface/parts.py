"""Which separate parts of an object stay in its mesh. Knows lattices and points only."""

from __future__ import annotations

import numpy as np

from reconstruction.surface.seen_cells import CORNERS

SEEN_POINTS = 15
"""A part with this many seen points in its cells, and this share of them all, is no stray measurement: it
stays however small it is."""
SEEN_SHARE = 0.02
"""Real masks bleed: what holds less of an object's seen points, away from the rest, is mostly not its own."""


def parts_to_keep(parts: np.ndarray, smallest: float, cells: np.ndarray | None) -> np.ndarray:
    """Numbers of the parts that are large enough or were seen.

    parts: (nx, ny, nz) the number of each node's part, 0 outside; smallest: share of the largest
    part's nodes; cells: (N, 3) the lattice cells of seen points, None when nothing is known of them.
    """
    sizes = np.bincount(parts.ravel())
    sizes[0] = 0
    keep = sizes >= smallest * sizes.max()
    keep[0] = False
    if cells is not None and not keep[1:].all():
        inside = ((cells >= 0) & (cells < np.array(parts.shape) - 1)).all(1)
        # Thousands of points lie in hundreds of cells.
        flat = np.ravel_multi_index(tuple(cells[inside].T), parts.shape)
        cell, points = np.unique(flat, return_counts=True)
        owner = parts.reshape(-1)[cell[:, None] + np.ravel_multi_index(tuple(CORNERS.T), parts.shape)].max(1)
        least = max(SEEN_POINTS, SEEN_SHARE * len(cells))
        keep |= (np.bincount(owner, points, minlength=len(sizes)) >= least) & (sizes > 0)
    return np.flatnonzero(keep)
