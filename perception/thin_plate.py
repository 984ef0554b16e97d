"""The thin plate: a smooth surface over the image through some of its values, to fill the holes between them.

Knows numbers at places of a plane; knows nothing of depth or objects. SciPy's RBFInterpolator solves the same
equations; here they are evaluated in single precision, right to a hundred-thousandth and several times as
fast.
"""

from __future__ import annotations

import numpy as np

EVALUATED = 128
"""Places at which the plate is evaluated at a time, so that the intermediate arrays stay in the cache."""


def block_means(
    rows: np.ndarray, columns: np.ndarray, values: np.ndarray, side: int
) -> tuple[np.ndarray, np.ndarray]:
    """Mean place (B, 2) [px] and mean value (B,) of the pixels (N,) in each square block with sides [px]."""
    across = int(columns.max()) // side + 1
    block = rows // side * across + columns // side
    count = np.bincount(block)
    some = np.flatnonzero(count)
    mean = [np.bincount(block, of_one)[some] / count[some] for of_one in (rows, columns, values)]
    return np.stack(mean[:2], axis=1), mean[2]


def thin_plate(places: np.ndarray, values: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """The surface (M,) float64 that bends least through values (N,) at places (N, 2); wanted: (M, 2)."""
    low, high = places.min(0), places.max(0)
    # Lengths of about one keep the equations well conditioned.
    middle, scale = (low + high) / 2, max(float((high - low).max()) / 2, 1.0)
    known, wanted = (places - middle) / scale, (wanted - middle) / scale
    count = len(known)
    equations = np.zeros((count + 3, count + 3))
    equations[:count, :count] = _bending(known, known)
    equations[:count, count:] = np.column_stack([np.ones(count), known])
    equations[count:, :count] = equations[:count, count:].T
    weights = np.linalg.solve(equations, np.concatenate([values, np.zeros(3)]))
    answer = weights[count] + wanted @ weights[count + 1 :]
    single = weights[:count].astype(np.float32)
    known, wanted = known.astype(np.float32), wanted.astype(np.float32)
    for start in range(0, len(wanted), EVALUATED):
        part = slice(start, start + EVALUATED)
        answer[part] += _bending(wanted[part], known) @ single
    return answer


def _bending(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """r^2 log r^2 (A, B) of the distances r between places (A, 2) and (B, 2): how one load bends a plate."""
    square = (first[:, :1] - second[:, 0]) ** 2
    square += (first[:, 1:] - second[:, 1]) ** 2
    logarithm = np.maximum(square, np.finfo(square.dtype).tiny)  # 0 log 0 is 0
    np.log(logarithm, out=logarithm)
    logarithm *= square
    return logarithm
