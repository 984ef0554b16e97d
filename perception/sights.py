"""Points seen through a depth image with a frame of unknown pixels around it, as machine code.

Knows a projection and an image as plain arrays; knows nothing of observations or regions' names.
Points come axis by axis: x, y, z (N,) float32 [m]. A (3, 3) and b (3,) float32 with
A p + b = (u z, v z, z), where u and v, cut off, count columns and rows of the framed image.
"""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled

NEAREST_DEPTH = np.float32(1e-4)
"""Points nearer to the camera's plane than this, or behind it, have no pixel [m]."""
_ZERO, _ONE = np.float32(0), np.float32(1)


@compiled
def sights(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, A: np.ndarray, b: np.ndarray, framed: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Flat index of each point's pixel in the image without its frame, -1 outside; its depth along the
    camera's z [m], and how far it lies behind what was measured there [m], NaN where nothing was: (N,) int32
    and float32. framed: (H + 2, W + 2) float32 depth [m], NaN where unknown."""
    height, width = framed.shape[0] - 2, framed.shape[1] - 2
    pixel, depth = _framed_pixels(x, y, z, A, b, framed.shape)
    behind, measured = np.empty_like(depth), framed.reshape(-1)
    for i in range(len(x)):
        behind[i] = depth[i] - measured[pixel[i]]
    for i in range(len(x)):
        row = np.int32(pixel[i] // np.int32(width + 2))
        column = pixel[i] - row * np.int32(width + 2)
        inside = (row > 0) & (row <= height) & (column > 0) & (column <= width)
        pixel[i] = (row - 1) * np.int32(width) + column - 1 if inside else -1
    return pixel, depth, behind


@compiled
def ranks(
    x: np.ndarray,
    y: np.ndarray,
    z: np.ndarray,
    A: np.ndarray,
    b: np.ndarray,
    framed: np.ndarray,
    guessed: np.ndarray,
    margin: float,
    growth: float,
    lowest: float,
) -> np.ndarray:
    """What the image says of each point (N,) int8: 0 before what was measured, 1 within the margin of it, 2
    behind it, 3 where nothing was measured, 4 below the height `lowest`, whatever was.

    The margin grows by `growth` times the depth's square. guessed: (H + 2, W + 2) bool, or (0, 0) for
    nowhere: pixels whose depth says nothing but of what lies behind it.
    """
    pixel, beyond = _framed_pixels(x, y, z, A, b, framed.shape)
    found, measured = np.empty(len(x), np.int8), framed.reshape(-1)
    for i in range(len(x)):
        depth = measured[pixel[i]]
        beyond[i] -= depth
        reach = margin + growth * depth * depth
        # All comparisons with NaN are false.
        before, behind = beyond[i] < -reach, beyond[i] > reach
        found[i] = np.int8(0 if before else 2 if behind else 1 if depth == depth else 3)
    if guessed.size:
        only_behind = guessed.reshape(-1)
        for i in range(len(x)):
            if only_behind[pixel[i]] and found[i] != 2:
                found[i] = 3
    for i in range(len(x)):
        found[i] = np.int8(4) if z[i] < lowest else found[i]
    return found


@compiled
def _framed_pixels(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, A: np.ndarray, b: np.ndarray, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Flat index (N,) int32 of points in the framed image of a shape, and their depth (N,) float32 [m]; on
    the frame where they are outside."""
    last_row, last_column = np.float32(shape[0] - 1), np.float32(shape[1] - 1)
    width = np.int32(shape[1])
    pixel, depth = np.empty(len(x), np.int32), np.empty(len(x), np.float32)
    for i in range(len(x)):
        far = A[2, 0] * x[i] + A[2, 1] * y[i] + A[2, 2] * z[i] + b[2]
        inverse = _ONE / (far if far > NEAREST_DEPTH else NEAREST_DEPTH)
        u = (A[0, 0] * x[i] + A[0, 1] * y[i] + A[0, 2] * z[i] + b[0]) * inverse
        v = (A[1, 0] * x[i] + A[1, 1] * y[i] + A[1, 2] * z[i] + b[1]) * inverse
        # Written so that NaN, too, ends on the frame; no branches, so that the loop becomes vectors.
        u = u if u > _ZERO else _ZERO
        v = v if v > _ZERO else _ZERO
        u = u if u < last_column else last_column
        v = v if v < last_row else last_row
        u = u if far >= NEAREST_DEPTH else _ZERO
        pixel[i] = np.int32(v) * width + np.int32(u)
        depth[i] = far
    return pixel, depth
