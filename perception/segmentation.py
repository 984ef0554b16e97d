"""Fallback segmentation for frames without labels: remove the support plane, part what stands on it."""

from __future__ import annotations

import numpy as np

from perception.camera import Camera
from perception.concave_split import split_at_creases
from perception.config import PerceptionConfig
from perception.depth_edges import joined_neighbours
from perception.joining import connected_pieces
from perception.observation import SupportPlane

HULL_MARGIN = 0.15
"""Objects may stand this far outside the hull of the visible table, if nothing speaks against it [m]."""
SEEN_THROUGH = 0.25
"""Where the camera looks through the plane at more than this share of its feet, nothing stands."""
LARGEST_EXTENT = 0.5
"""What is larger than this diagonally along the table is furniture [m]."""
PIECE_POINTS = 500
"""Points of a piece that its stand is judged from."""
HULL_POINTS = 5_000
"""Points of the table that its hull is taken from."""


def segment(
    points: np.ndarray, support: SupportPlane | None, camera: Camera, config: PerceptionConfig
) -> np.ndarray:
    """Instance labels (H, W) uint16 of what stands on the support plane, 0 elsewhere.

    Pieces are joined where neighbouring pixels have no depth jump, so objects that touch can come out
    as one. points: (H, W, 3) float32 [m] in the camera frame, NaN where missing.
    """
    depth = points[..., 2]
    measured = np.isfinite(depth)
    joined = joined_neighbours(depth, camera, config)
    if support is None:
        pieces = connected_pieces(*joined, measured)
        keep = _large_enough(pieces, depth, camera, config)
    else:
        height = points @ support.normal.astype(np.float32) + np.float32(support.offset)
        pieces = connected_pieces(*joined, measured & (height > config.segment_height))
        pieces = split_at_creases(pieces, joined, points, camera, config)
        table = connected_pieces(*joined, np.abs(height) < support.threshold)
        keep = _large_enough(pieces, depth, camera, config)
        keep &= _stands_on_table(pieces, keep, table, points, height, support, camera, config)
    keep[0] = False
    number = np.where(keep, np.cumsum(keep), 0).astype(np.uint16)
    return number[pieces]


def _large_enough(
    pieces: np.ndarray, depth: np.ndarray, camera: Camera, config: PerceptionConfig
) -> np.ndarray:
    """Which pieces (P,) show enough surface, seen from the camera [m^2]."""
    area = np.nan_to_num(depth) ** 2 / (camera.K[0, 0] * camera.K[1, 1])
    return np.bincount(pieces.reshape(-1), weights=area.reshape(-1)) >= config.segment_minimum_area


def _stands_on_table(
    pieces: np.ndarray,
    candidate: np.ndarray,
    table: np.ndarray,
    points: np.ndarray,
    height: np.ndarray,
    support: SupportPlane,
    camera: Camera,
    config: PerceptionConfig,
) -> np.ndarray:
    """Which candidate pieces (P,) begin near the table and stand on or beside its visible part.

    A tall object at the table's end hides the table under it, so the hull of what is seen is not
    the limit: the limit is where the camera looks through the plane.
    """
    import cv2

    count = np.bincount(table.reshape(-1))
    count[0] = 0
    if count.size < 2:
        return candidate
    flat, heights, of = points.reshape(-1, 3), height.reshape(-1), pieces.reshape(-1)
    # Two axes along the plane: the rows of a basis whose third row is the normal.
    axes = np.linalg.svd(support.normal[None])[2][1:].astype(np.float32)
    seen = flat[table.reshape(-1) == count.argmax()]
    hull = cv2.convexHull(np.ascontiguousarray(seen[:: 1 + len(seen) // HULL_POINTS] @ axes.T))
    stands = np.zeros(len(candidate), bool)
    order = np.argsort(of, kind="stable")
    begin = np.searchsorted(of[order], np.arange(len(candidate) + 1))
    for piece in np.flatnonzero(candidate):
        if piece == 0:
            continue
        mine = order[begin[piece] : begin[piece + 1]]
        mine = mine[:: 1 + len(mine) // PIECE_POINTS]
        along = flat[mine] @ axes.T
        middle = np.median(along, axis=0)
        inside = cv2.pointPolygonTest(hull, (float(middle[0]), float(middle[1])), True)
        stands[piece] = (
            np.quantile(heights[mine], 0.02) < config.segment_float
            and np.linalg.norm(np.ptp(np.quantile(along, [0.02, 0.98], axis=0), axis=0)) < LARGEST_EXTENT
            and inside > -HULL_MARGIN
            and (
                inside > 0 or _seen_through(flat[mine], heights[mine], points, support, camera) < SEEN_THROUGH
            )
        )
    return stands


def _seen_through(
    own: np.ndarray, height: np.ndarray, points: np.ndarray, support: SupportPlane, camera: Camera
) -> float:
    """Share of a piece's feet on the plane where the camera measured something under the plane."""
    feet = own - height[:, None] * support.normal.astype(np.float32)
    uv, z = camera.project(feet)
    seen = (z > 0) & (uv > -0.5).all(1) & (uv < np.array([camera.width, camera.height]) - 0.5).all(1)
    if not seen.any():
        return 0.0
    column, row = np.rint(uv[seen]).astype(int).T
    under = points[row, column] @ support.normal + support.offset < -2 * support.threshold
    return float(under.mean())
