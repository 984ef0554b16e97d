"""Which pieces of a bled mask belong to its object: Euclidean clusters, and the pieces that an edge parts."""

from __future__ import annotations

import numpy as np

from perception.camera import Camera
from perception.config import PerceptionConfig
from perception.depth_edges import beyond_mask, depth_jump
from perception.joining import connected_points
from perception.observation import SupportPlane
from perception.quantiles import column_quantiles

PIECE_SHARE = 0.02
"""A piece parted from the main cluster must have this share of its pixels to be taken back."""
COVERED_SHARE = 2 / 3
"""Share of the gap between two pieces that something in front must cover: near its ends, pixels are mixed."""
LEAK_SHARE = 0.3
"""A piece whose outer border runs on smoothly beyond the mask for more than this share is bleed."""
NEAR_SHARE = 0.5
"""A piece without leak is taken back within this share of the main cluster's diagonal."""


def main_cluster(
    points: np.ndarray,
    labels: np.ndarray,
    pixels: np.ndarray,
    support: SupportPlane | None,
    camera: Camera,
    config: PerceptionConfig,
) -> np.ndarray:
    """Which pixels (N,) of one mask belong to its main 3D cluster or to a parted piece of the object.

    points: (H, W, 3) float32 [m] in the camera frame. labels: (H, W) as given.
    pixels: (N,) ascending flat indices of the mask's pixels to judge.
    """
    flat, raw = points.reshape(-1, 3), labels.reshape(-1)
    own, label = flat.take(pixels, axis=0), int(raw[pixels[0]])
    cluster = _euclidean_clusters(own, camera, config)
    size = np.bincount(cluster)
    keep = np.zeros(len(size), bool)
    keep[size.argmax()] = True  # ties go to the piece met first in the image
    candidate = np.flatnonzero(~keep & (size >= config.minimum_pixels) & (size >= PIECE_SHARE * size.max()))
    if candidate.size:
        leak = _leak_share(flat, raw, pixels, cluster, support, camera, config)
        for piece in candidate[np.argsort(-size[candidate], kind="stable")]:
            core, part = own[keep[cluster]], own[cluster == piece]
            start, end = closest_pair(core, part)
            gap = float(np.linalg.norm(end - start))
            near = NEAR_SHARE * float(np.linalg.norm(np.ptp(column_quantiles(core, 0.05, 0.95), axis=0)))
            if gap > config.split_gap:
                continue
            keep[piece] = (leak[piece] < LEAK_SHARE and gap < near) or covered(
                start, end, label, flat, raw, camera, config
            )
    return keep[cluster]


def _euclidean_clusters(points: np.ndarray, camera: Camera, config: PerceptionConfig) -> np.ndarray:
    """Cluster number (N,) of points (N, 3): connected voxels, numbered in image order."""
    # Far away, pixels and noise spread wider than the gap asked for, so the voxel grows with depth.
    pixel = 3.0 / min(camera.K[0, 0], camera.K[1, 1])
    z = float(np.median(points[:: 1 + len(points) // 1000, 2]))
    side = max(config.cluster_gap / 1.5, pixel * z, 2 * config.depth_noise * z * z)
    return connected_points(points, np.float32(1 / side))


def _leak_share(
    flat: np.ndarray,
    raw: np.ndarray,
    pixels: np.ndarray,
    cluster: np.ndarray,
    support: SupportPlane | None,
    camera: Camera,
    config: PerceptionConfig,
) -> np.ndarray:
    """Share (clusters,) of each cluster's border with other labels where the surface simply runs on.

    A mask that bleeds takes a strip of the surface behind, which goes on beyond the mask. An object's
    own piece ends there: in a depth jump, or on the table, which does not count.
    """
    which, outer = beyond_mask(pixels, raw, camera.width)
    depth = flat[pixels[which], 2]
    leak = np.abs(flat[outer, 2] - depth) < depth_jump(depth, camera, config)
    if support is not None:
        leak &= np.abs(flat[outer] @ support.normal + support.offset) > config.plane_threshold
    of, count = cluster[which], int(cluster.max()) + 1
    return np.bincount(of, weights=leak, minlength=count) / np.maximum(1, np.bincount(of, minlength=count))


def closest_pair(main: np.ndarray, piece: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """About the closest points (3,) of two point sets (N, 3) and (M, 3), looked for among some of them."""
    from scipy.spatial import cKDTree

    main, piece = main[:: 1 + len(main) // 2000], piece[:: 1 + len(piece) // 500]
    distance, nearest = cKDTree(main).query(piece)
    closest = int(np.argmin(distance))
    return main[nearest[closest]], piece[closest]


def covered(
    start: np.ndarray,
    end: np.ndarray,
    label: int,
    flat: np.ndarray,
    raw: np.ndarray,
    camera: Camera,
    config: PerceptionConfig,
) -> bool:
    """Whether the gap from start to end (3,) is hidden behind something nearer that is not this object.

    Label bleed adjoins its object in the image, with nothing of another object in between.
    """
    along = np.linspace(0.1, 0.9, 33)[:, None]
    uv, z = camera.project((1 - along) * start + along * end)
    column = np.clip(np.rint(uv[:, 0]).astype(int), 0, camera.width - 1)
    row = np.clip(np.rint(uv[:, 1]).astype(int), 0, camera.height - 1)
    pixel = row * camera.width + column
    nearer = np.nan_to_num(flat[pixel, 2], nan=np.inf) < z - depth_jump(z, camera, config)
    return bool((nearer & (raw[pixel] != label)).mean() >= COVERED_SHARE)
