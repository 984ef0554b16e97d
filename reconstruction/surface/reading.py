"""What a depth image says of points, for one object: the loop over them.

Knows arrays of one image and of one object's edges in it; knows nothing of observations, maps or lattices.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mapping.compiled import compiled

NOT_MEASURED = -2
BACKGROUND = -1
"""Owners of pixels that are no object's: without depth, and of the table or the room."""
FAR = 0.1
"""Distances beyond this do not matter to any surface [m]."""
NEAREST = np.float32(1e-4)
"""Points nearer to the camera's plane than this, or behind it, are taken to be as far [m]."""
BEYOND = np.float32(1e6)
"""Pixel coordinates beyond this are outside of any image."""
LEAST_LATERAL = np.float32(5e-5)
"""Points exactly on the edge are beside it [m]."""
SHAVED = 0.05
"""An outline is taken to be so much inside of the middle between pixels [px]: free space that was measured
stays free although a lattice rounds outlines off."""
_FAR, _ZERO = np.float32(FAR), np.float32(0)
_INSIDE, _BESIDE = np.float32(0.5 + SHAVED), np.float32(0.5 - SHAVED)


class Reading(NamedTuple):
    """What the depth image says of N points, for one object.

    distance: (N,) float32 [m] behind the measured surface or beside the silhouette, negative in free space
    and below the floor, FAR where nothing is known. depth: (N,) float32 [m] below the object's own surface,
    FAR where it is not seen. others: (N,) float32 [m] below the surface of another object seen there, else
    FAR.
    """

    distance: np.ndarray
    depth: np.ndarray
    others: np.ndarray


class Image(NamedTuple):
    """A depth image as points see it.

    A (3, 3), b (3,) float32: A x + b = (u z, v z, z); focal: [px]; owner, depth: (H, W), int32 and float32;
    planes: (H * W, 4) float32 that each pixel sees.
    """

    A: np.ndarray
    b: np.ndarray
    focal: np.float32
    owner: np.ndarray
    depth: np.ndarray
    planes: np.ndarray


class Outline(NamedTuple):
    """The edges of one object in an image, as in `Edges`. own: its number as an owner; floor: it is above
    this height [m]."""

    own: int
    floor: np.float32
    top: int
    left: int
    nearest: np.ndarray
    distances: np.ndarray
    planes: np.ndarray


@compiled
def read_points(points: np.ndarray, image: Image, outline: Outline) -> tuple[np.ndarray, ...]:
    """The three arrays of a `Reading` of points (N, 3) float32 [m]."""
    distance = np.empty(len(points), np.float32)
    depth, others = np.empty_like(distance), np.empty_like(distance)
    read_into(points, image, outline, distance, depth, others)
    return distance, depth, others


@compiled
def _pixel_of(
    x: float, y: float, z: float, A: np.ndarray, b: np.ndarray
) -> tuple[float, float, float, int, int]:
    """How far before the camera a point is [m], where its image is [px], and the nearest row and column."""
    away = max(A[2, 0] * x + A[2, 1] * y + A[2, 2] * z + b[2], NEAREST)
    u = (A[0, 0] * x + A[0, 1] * y + A[0, 2] * z + b[0]) / away
    v = (A[1, 0] * x + A[1, 1] * y + A[1, 2] * z + b[1]) / away
    row, column = int(np.rint(min(max(v, -BEYOND), BEYOND))), int(np.rint(min(max(u, -BEYOND), BEYOND)))
    return away, u, v, row, column


@compiled
def _between(image: np.ndarray, row: float, column: float) -> float:
    """The value of an image (h, w) between its pixels. Distances from pixels taken so make straight outlines
    of steps of pixels; distances from their middles would make them scalloped."""
    height, width = image.shape
    i, j = min(max(int(row), 0), height - 2), min(max(int(column), 0), width - 2)
    down, across = np.float32(row) - np.float32(i), np.float32(column) - np.float32(j)
    above = image[i, j] + across * (image[i, j + 1] - image[i, j])
    below = image[i + 1, j] + across * (image[i + 1, j + 1] - image[i + 1, j])
    return above + down * (below - above)


@compiled
def faced(points: np.ndarray, image: Image, own: int) -> tuple[np.ndarray, np.ndarray]:
    """Of what object `own` shows on the ray through each of points (N, 3) float32 [m]: the normal (N, 3) away
    from the camera, 0 where it shows nothing there, and how far the point is behind it (N,) [m], 0 there."""
    A, b, _, owners, _, planes = image
    rows, columns = owners.shape
    normals, behind = np.zeros((len(points), 3), np.float32), np.zeros(len(points), np.float32)
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        _, _, _, row, column = _pixel_of(x, y, z, A, b)
        if 0 <= column < columns and 0 <= row < rows and owners[row, column] == own:
            at = row * columns + column
            for axis in range(3):
                normals[i, axis] = planes[at, axis]
            behind[i] = planes[at, 0] * x + planes[at, 1] * y + planes[at, 2] * z - planes[at, 3]
    return normals, behind


@compiled
def lower_near(
    points: np.ndarray, image: Image, outline: Outline, within: float, rim: float, share: np.ndarray
) -> None:
    """Lower share (N,) float32 where points (N, 3) float32 [m] are near what the object shows on their ray:
    to 0 there, linearly to 1 at a distance of `within` [m]; and linearly to 1 from `rim` [px] to `rim` - 1
    from its image's outermost pixels."""
    A, b, _, owners, _, planes = image
    own, _, top, left, _, distances, _ = outline
    rows, columns = owners.shape
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        _, u, v, row, column = _pixel_of(x, y, z, A, b)
        if 0 <= column < columns and 0 <= row < rows and owners[row, column] == own:
            at = row * columns + column
            a, d, c = planes[at, 0], planes[at, 1], planes[at, 2]
            off = abs(a * x + d * y + c * z - planes[at, 3]) / within
            if off < share[i] and (a != _ZERO or d != _ZERO or c != _ZERO):
                if rim > _ZERO:
                    off = min(max(off, rim - _between(distances[0], v - top, u - left)), share[i])
                share[i] = off


@compiled
def read_into(
    points: np.ndarray,
    image: Image,
    outline: Outline,
    distances: np.ndarray,
    below_own: np.ndarray,
    below_others: np.ndarray,
) -> None:
    """Fill the three arrays (N,) float32 of a `Reading` of points (N, 3) float32 [m]."""
    A, b, focal, owners, depths, planes = image
    own, floor, top, left, nearest, edge_distances, edge_planes = outline
    rows, columns = owners.shape
    _, height, width = nearest.shape
    # Planes are read number by number: references to rows would be counted, which takes as long as the rest.
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        away, u, v, row, column = _pixel_of(x, y, z, A, b)
        owner, behind = NOT_MEASURED, _FAR
        if 0 <= column < columns and 0 <= row < rows:
            owner = owners[row, column]
            if owner == BACKGROUND:
                # The table and the room need no planes: nothing is built on them.
                behind = away - depths[row, column]
            elif owner != NOT_MEASURED:
                at = row * columns + column
                behind = planes[at, 0] * x + planes[at, 1] * y + planes[at, 2] * z - planes[at, 3]
        free = owner != NOT_MEASURED and behind < _ZERO
        # The part's outermost pixels have no edge near: whatever lies beyond is taken for one of them.
        side = 0 if free else 1
        edge = nearest[side, min(max(row - top, 0), height - 1), min(max(column - left, 0), width - 1)]
        lateral = _FAR
        if edge > 0:
            before = edge_planes[edge, 0] * x + edge_planes[edge, 1] * y + edge_planes[edge, 2] * z
            before = min(before - edge_planes[edge, 3], _ZERO)
            # Free space beyond an edge matters to a point that lies before the surface there.
            if free or before < _ZERO:
                off = _between(edge_distances[side], v - top, u - left) - (_BESIDE if free else _INSIDE)
                across = max(max(off, _ZERO) * away / focal, LEAST_LATERAL)
                # A free point before the surface that ends there is so much farther from it.
                lateral = min(np.sqrt(across * across + before * before) if free else across, _FAR)
        # Behind what is not its own, nothing is known of this object.
        distance = _FAR
        if free:
            distance = max(behind, -lateral)
        elif owner in (own, NOT_MEASURED):
            distance = min(behind, lateral)
        distances[i] = min(distance, z - floor)
        below_own[i] = behind if owner == own and not free else _FAR
        below_others[i] = behind if owner >= 0 and owner != own else _FAR
