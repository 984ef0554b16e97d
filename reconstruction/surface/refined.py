"""A lattice whose cells are divided by a factor along each axis. Knows lattices only."""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled


@compiled
def nodes_of_cells(cells: np.ndarray, factor: int) -> np.ndarray:
    """Flat fine nodes (M,), of factor n + 1 an axis and in their order, in and on coarse cells, n an axis."""
    nx, ny, nz = cells.shape
    height, width, depth = factor * nx + 1, factor * ny + 1, factor * nz + 1
    filled = np.zeros((nx, ny), np.bool_)
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                filled[i, j] |= cells[i, j, k]
    nodes = np.empty(height * width * depth, np.int64)
    held = np.empty(nz, np.bool_)
    count = 0
    for i in range(height):
        for j in range(width):
            some = False
            # A fine row lies in one row of cells, or on the border of two, or of four.
            for a in range(max((i - 1) // factor, 0), min(i // factor, nx - 1) + 1):
                for b in range(max((j - 1) // factor, 0), min(j // factor, ny - 1) + 1):
                    if filled[a, b]:
                        for k in range(nz):
                            held[k] = cells[a, b, k] or (some and held[k])
                        some = True
            if some:
                node = (i * width + j) * depth
                for k in range(nz):
                    if held[k]:
                        for step in range(k > 0 and held[k - 1], factor + 1):
                            nodes[count] = node + step
                            count += 1
                    node += factor
    return nodes[:count].copy()


@compiled
def spread(values: np.ndarray, factor: int) -> np.ndarray:
    """Values (nx, ny, nz) on `factor` times as many cells an axis, each node's as far as the next node's."""
    nx, ny, nz = values.shape
    fine = np.empty((factor * (nx - 1) + 1, factor * (ny - 1) + 1, factor * (nz - 1) + 1), values.dtype)
    for i in range(fine.shape[0]):
        for j in range(fine.shape[1]):
            wide = fine[i, j]
            if i % factor or j % factor:  # as in the row before
                before = fine[i - (i % factor > 0), j - (i % factor == 0)]
                for k in range(len(wide)):
                    wide[k] = before[k]
                continue
            row = values[i // factor, j // factor]
            for k in range(nz - 1):
                for step in range(factor):
                    wide[factor * k + step] = row[k]
            wide[len(wide) - 1] = row[nz - 1]
    return fine


@compiled
def interpolated(values: np.ndarray, factor: int, nodes: np.ndarray) -> np.ndarray:
    """Linear interpolation of (nx, ny, nz) float32 at flat fine nodes (M,), of factor (n - 1) + 1 an axis
    and in ascending order."""
    nx, ny, nz = values.shape
    width, depth = factor * (ny - 1) + 1, factor * (nz - 1) + 1
    share = (np.arange(factor) / factor).astype(np.float32)
    rest = np.float32(1) - share
    found = np.empty(len(nodes), np.float32)
    row, first = -1, -depth  # the fine row, and its first node: divisions would take most of the time
    one = two = three = four = values[0, 0]  # the coarse rows around it
    a = b = 0
    for m in range(len(nodes)):
        if nodes[m] >= first + depth:
            while nodes[m] >= first + depth:
                first += depth
                row += 1
            i, a = row // width // factor, row // width % factor
            j, b = row % width // factor, row % width % factor
            # On the last node there is no next one, and no share of it.
            i_next, j_next = min(i + 1, nx - 1), min(j + 1, ny - 1)
            one, two = values[i, j], values[i, j_next]
            three, four = values[i_next, j], values[i_next, j_next]
        k = np.uint32(nodes[m] - first) // np.uint32(factor)
        c, k_next = nodes[m] - first - k * factor, min(k + 1, nz - 1)
        near = (two[k_next] * share[c] + two[k] * rest[c]) * share[b]
        near += (one[k_next] * share[c] + one[k] * rest[c]) * rest[b]
        far = (four[k_next] * share[c] + four[k] * rest[c]) * share[b]
        far += (three[k_next] * share[c] + three[k] * rest[c]) * rest[b]
        found[m] = far * share[a] + near * rest[a]
    return found


@compiled
def values_at(values: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Linear interpolation of (nx, ny, nz) float32 at places (M, 3), in nodes; those beyond the lattice are
    taken for the nearest in it."""
    nx, ny, nz = values.shape
    found = np.empty(len(places), np.float32)
    for m in range(len(places)):
        x, y, z = max(places[m, 0], 0.0), max(places[m, 1], 0.0), max(places[m, 2], 0.0)
        i, j, k = min(int(x), nx - 1), min(int(y), ny - 1), min(int(z), nz - 1)
        a, b, c = min(x, nx - 1.0) - i, min(y, ny - 1.0) - j, min(z, nz - 1.0) - k
        total = 0.0
        for di in range(2):
            for dj in range(2):
                for dk in range(2):
                    value = np.float64(values[min(i + di, nx - 1), min(j + dj, ny - 1), min(k + dk, nz - 1)])
                    total += value * (a if di else 1 - a) * (b if dj else 1 - b) * (c if dk else 1 - c)
        found[m] = total
    return found
