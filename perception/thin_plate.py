"""The thin plate: a smooth surface over the image through some of its values, to fill the holes between them.

Knows numbers at places of a plane; knows nothing of depth or objects. SciPy's RBFInterpolator solves the same
equations; here bending is worked out in single precision, right to a hundred-thousandth and several times
as fast.
"""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled

EVALUATED = 128
"""Places at which the plate is evaluated at a time, so that the intermediate arrays stay in the cache."""


def block_means(
    rows: np.ndarray, columns: np.ndarray, values: np.ndarray, side: int
) -> tuple[np.ndarray, np.ndarray]:
    """Mean place (B, 2) [px] and mean value (B,) of the pixels (N,) in each square block with sides [px]."""
    total = np.zeros((int(rows.max()) // side + 1, int(columns.max()) // side + 1, 4))
    _add_to_blocks(total, rows, columns, values, side)
    some = total[total[..., 3] > 0]
    return some[:, :2] / some[:, 3:], some[:, 2] / some[:, 3]


@compiled
def _add_to_blocks(
    total: np.ndarray, rows: np.ndarray, columns: np.ndarray, values: np.ndarray, side: int
) -> None:
    """Add row, column, value and 1 of each pixel (N,) to its block in total (., ., 4)."""
    for pixel in range(len(rows)):
        row, column = rows[pixel] // side, columns[pixel] // side
        total[row, column, 0] += rows[pixel]
        total[row, column, 1] += columns[pixel]
        total[row, column, 2] += values[pixel]
        total[row, column, 3] += 1


def thin_plate(places: np.ndarray, values: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """The surface (M,) float64 that bends least through values (N,) at places (N, 2); wanted: (M, 2)."""
    low, high = places.min(0), places.max(0)
    # Lengths of about one keep the equations well conditioned.
    middle, scale = (low + high) / 2, max(float((high - low).max()) / 2, 1.0)
    known = ((places - middle) / scale).astype(np.float32)
    wanted = ((wanted - middle) / scale).astype(np.float32)
    count = len(known)
    equations = np.zeros((count + 3, count + 3))
    equations[:count, :count] = _bending(known, known)
    equations[:count, count] = 1
    equations[:count, count + 1 :] = known
    equations[count:, :count] = equations[:count, count:].T
    weights = np.linalg.solve(equations, np.concatenate([values, np.zeros(3)]))
    answer = weights[count] + wanted @ weights[count + 1 :]
    weights = weights[:count].astype(np.float32)
    for start in range(0, len(wanted), EVALUATED):
        part = slice(start, start + EVALUATED)
        answer[part] += _bending(wanted[part], known) @ weights
    return answer


def _bending(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """r^2 log r^2 (A, B) of the distances r between places (A, 2) and (B, 2): how one load bends a plate."""
    square = (first[:, :1] - second[:, 0]) ** 2
    square += (first[:, 1:] - second[:, 1]) ** 2
    logarithm = np.maximum(square, np.finfo(square.dtype).tiny)  # 0 log 0 is 0
    np.log(logarithm, out=logarithm)
    logarithm *= square
    return logarithm
