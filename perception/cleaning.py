"""From raw depth and bled masks to the points that are truly an object's. Everything in the camera frame."""

from __future__ import annotations

import numpy as np

from perception.camera import Camera
from perception.config import PerceptionConfig
from perception.observation import SupportPlane

NEIGHBOUR_VOXELS = 1.75
"""Occupied voxels whose centres are this near (26 neighbours) belong to one cluster [voxels]."""
PIECE_SHARE = 0.02
"""A piece parted from the main cluster must have this share of its pixels to be taken back."""
COVERED_SHARE = 0.8
"""Share of the gap between two pieces that something in front must cover."""


def depth_jump(depth: np.ndarray, camera: Camera, config: PerceptionConfig) -> np.ndarray:
    """Depth step [m] between neighbouring pixels that no surface in sight explains; depth (...) [m]."""
    per_pixel = np.tan(np.radians(config.grazing_angle)) / min(camera.K[0, 0], camera.K[1, 1])
    return np.float32(per_pixel) * depth + np.float32(2 * config.depth_noise) * depth * depth


def remove_flying_pixels(depth: np.ndarray, camera: Camera, config: PerceptionConfig) -> np.ndarray:
    """A copy of depth (H, W) [m] with NaN where a pixel hangs between a nearer and a farther surface.

    Such pixels mix foreground and background. A thin object is the nearest of its
    neighbourhood, so it stays.
    """
    import cv2

    jump = depth_jump(depth, camera, config)
    missing = np.isnan(depth)
    kernel = np.ones((3, 3), np.uint8)
    nearest = cv2.erode(np.where(missing, np.float32(np.inf), depth), kernel)
    farthest = cv2.dilate(np.where(missing, np.float32(0), depth), kernel)
    flying = (depth - nearest > jump) & (farthest - depth > jump)
    cleaned = depth.copy()
    cleaned[flying] = np.nan
    return cleaned


def clean_labels(
    points: np.ndarray,
    labels: np.ndarray,
    support: SupportPlane | None,
    camera: Camera,
    config: PerceptionConfig,
) -> np.ndarray:
    """Labels (H, W) uint16 with 0 where a labelled pixel is invalid, on the table, or off its object.

    points: (H, W, 3) float32 [m] in the camera frame, NaN where missing.
    """
    flat, of = points.reshape(-1, 3), labels.reshape(-1)
    pixels = np.flatnonzero((of > 0) & np.isfinite(flat[:, 2]))
    cleaned = np.zeros_like(of)
    if support is not None:
        pixels = pixels[~_on_support(flat[pixels], of[pixels], support, config)]
    if pixels.size:
        kept = pixels[_main_clusters(flat, of, pixels, labels, camera, config)]
        cleaned[kept] = of[kept]
    return cleaned.reshape(labels.shape)


def _on_support(
    points: np.ndarray, of: np.ndarray, support: SupportPlane, config: PerceptionConfig
) -> np.ndarray:
    """Which labelled points (N, 3) lie on or under the support plane: bleed of the mask onto the table."""
    height = points @ support.normal.astype(np.float32) + np.float32(support.offset)
    noise = config.depth_noise * points[:, 2] ** 2
    limit = np.maximum(config.table_margin, 1.5 * noise)
    for label in np.unique(of):
        mine = of == label
        # Nearly all of a plate or a knife lies within the noise of the table: only what is below can go.
        if np.quantile(height[mine], 0.95) < config.flat_height:
            limit[mine] = -noise[mine]
    return height < limit


def _main_clusters(
    flat: np.ndarray,
    of: np.ndarray,
    pixels: np.ndarray,
    labels: np.ndarray,
    camera: Camera,
    config: PerceptionConfig,
) -> np.ndarray:
    """Which pixels (N,) belong to the main 3D cluster of their label, or to a piece parted by an occluder."""
    points, label = flat[pixels], of[pixels]
    cluster = _euclidean_clusters(points, label, camera, config)
    size = np.bincount(cluster)
    owner = np.zeros(len(size), label.dtype)
    owner[cluster] = label
    keep = np.zeros(len(size), bool)
    for name in np.unique(label):
        mine = np.flatnonzero(owner == name)
        main = mine[np.argmax(size[mine])]
        keep[main] = True
        enough = max(config.minimum_pixels, PIECE_SHARE * size[main])
        for piece in mine[size[mine] >= enough]:
            if piece != main and _parted_by_occluder(
                points[cluster == main], points[cluster == piece], name, flat, labels, camera, config
            ):
                keep[piece] = True
    return keep[cluster]


def _euclidean_clusters(
    points: np.ndarray, label: np.ndarray, camera: Camera, config: PerceptionConfig
) -> np.ndarray:
    """Cluster number (N,) of points (N, 3): connected voxels of one label, numbered in image order."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    depth = points[:, 2]
    # Far away, pixels and noise spread wider than the gap asked for, so the voxel grows with depth.
    pitch = 3.0 / min(camera.K[0, 0], camera.K[1, 1])
    per_label = np.zeros(int(label.max()) + 1)
    for name in np.unique(label):
        z = float(np.median(depth[label == name]))
        per_label[name] = max(config.cluster_gap / 1.5, pitch * z, 2 * config.depth_noise * z * z)
    cell = np.floor(points / per_label[label][:, None]).astype(np.int64)
    cell -= cell.min(0)
    shape = cell.max(0) + 1
    key = ((label.astype(np.int64) * shape[0] + cell[:, 0]) * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
    _, first, voxel = np.unique(key, return_index=True, return_inverse=True)
    # Labels are set far apart along a fourth axis, so that one tree serves all of them.
    centre = np.column_stack([cell[first], 10.0 * label[first]])
    pairs = cKDTree(centre).query_pairs(NEIGHBOUR_VOXELS, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(len(first),) * 2)
    return connected_components(graph, directed=False)[1][voxel.reshape(-1)]


def _parted_by_occluder(
    main: np.ndarray,
    piece: np.ndarray,
    label: int,
    flat: np.ndarray,
    labels: np.ndarray,
    camera: Camera,
    config: PerceptionConfig,
) -> bool:
    """Whether the gap between two pieces of an object is hidden behind something nearer.

    Label bleed adjoins its object in the image, with nothing of another object in between.
    """
    from scipy.spatial import cKDTree

    main, piece = main[:: max(1, len(main) // 1000)], piece[:: max(1, len(piece) // 300)]
    distance, nearest = cKDTree(main).query(piece)
    closest = int(np.argmin(distance))
    if distance[closest] > config.split_gap:
        return False
    start, end = main[nearest[closest]], piece[closest]
    along = np.linspace(0.1, 0.9, 33)[:, None]
    uv, z = camera.project((1 - along) * start + along * end)
    column = np.clip(np.rint(uv[:, 0]).astype(int), 0, camera.width - 1)
    row = np.clip(np.rint(uv[:, 1]).astype(int), 0, camera.height - 1)
    pixel = row * camera.width + column
    depth = flat[pixel, 2]
    nearer = np.nan_to_num(depth, nan=np.inf) < z - depth_jump(z, camera, config)
    return bool((nearer & (labels.reshape(-1)[pixel] != label)).mean() >= COVERED_SHARE)
