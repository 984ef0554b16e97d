"""One number on several things (two mugs of one class): they are split by space, each its own object.

Only where it is plain: both stand on the table, both are of a size, and in the wide gap between them the
camera sees something that carries another label and lies behind.
"""

from __future__ import annotations

import numpy as np

from perception.camera import Camera
from perception.checks.label_regions import LabelRegion
from perception.clusters import closest_pair, covered
from perception.config import PerceptionConfig
from perception.depth_edges import border_pairs, depth_jump, joined_neighbours
from perception.grouping import group_by_label
from perception.joining import connected_pieces
from perception.observation import SupportPlane

LEAST_PIXELS = 150
"""A thing of its own shows at least this many pixels ..."""
LEAST_SHARE = 0.3
"""... and this share of the largest thing of its number."""
LEAST_HEIGHT = 0.025
"""It is at least this tall [m]: flat things come in pieces."""
BEGINS_BELOW = 0.05
"""Its lowest points lie under this height above the support [m]."""
LEAST_GAP = 0.1
"""It lies at least this far from the others [m]: racks, bowls and boxes show pieces up to 9 cm apart."""
BETWEEN = 0.5
"""This share of the pixels between two things carries another label."""
QUICK_POINTS, QUICK_GAP, QUICK_SHARE = 250, 0.8, 0.15
"""Points of the first look, the part of the gap it asks for, and the least share of the largest part."""
LEAK = 0.35
"""A piece whose border runs on into another surface for more than this share is bleed of the mask."""


def in_parts(region: LabelRegion) -> bool:
    """Whether a label's points, thinned, fall into parts that lie far from each other: a quick first look."""
    from scipy.spatial.distance import cdist

    if region.sides[0] < LEAST_GAP:
        return False
    points = region.points[:: 1 + len(region.points) // QUICK_POINTS]
    beside = cdist(points, points, "sqeuclidean") <= (QUICK_GAP * LEAST_GAP) ** 2
    left, sizes = np.ones(len(points), bool), []
    while left.any():
        part = np.zeros(len(points), bool)
        new = np.flatnonzero(left)[:1]
        while len(new):
            part[new] = True
            new = np.flatnonzero(beside[new].any(0) & ~part)
        left &= ~part
        sizes.append(int(part.sum()))
    return sum(size > QUICK_SHARE * max(sizes) for size in sizes) > 1


def split_things(
    points: np.ndarray, labels: np.ndarray, support: SupportPlane, camera: Camera, config: PerceptionConfig
) -> tuple[np.ndarray, dict[int, int]]:
    """Labels (H, W) with a new number for every further thing of a number, and new number -> old number.

    points: (H, W, 3) [m] in the camera frame. New numbers are larger than all others.
    """
    height = points @ support.normal.astype(np.float32) + np.float32(support.offset)
    flat, raw = points.reshape(-1, 3), labels.reshape(-1)
    with np.errstate(invalid="ignore"):
        standing = (labels > 0) & (height > config.segment_height)
    right, down = joined_neighbours(points[..., 2], camera, config)
    right, down = right & (labels[:, 1:] == labels[:, :-1]), down & (labels[1:] == labels[:-1])
    pieces = connected_pieces(right, down, standing)
    size = np.bincount(pieces.reshape(-1))
    size[0] = 0
    large = np.flatnonzero(size >= LEAST_PIXELS)
    if len(large) < 2:
        return labels, {}
    pixels = np.flatnonzero(np.isin(pieces.reshape(-1), large))
    of = pieces.reshape(-1)[pixels]
    members = {int(piece): pixels[group] for piece, group in group_by_label(of)}
    label_of = {piece: int(raw[own[0]]) for piece, own in members.items()}
    leak = _leaks(pieces, flat, raw, height.reshape(-1), camera, config)
    result, origin = labels, {}
    following = int(labels.max()) + 1
    for label in dict.fromkeys(label_of.values()):
        mine = sorted((p for p in members if label_of[p] == label), key=lambda piece: -int(size[piece]))
        things = [mine[0]]
        if len(mine) < 2 or not _stands(height.reshape(-1)[members[mine[0]]]):
            continue
        for piece in mine[1:]:
            if (
                size[piece] >= LEAST_SHARE * size[mine[0]]
                and leak[piece] < LEAK
                and _stands(height.reshape(-1)[members[piece]])
                and following < 65535
                and all(
                    _apart(members[thing], members[piece], label, flat, raw, camera, config)
                    for thing in things
                )
            ):
                things.append(piece)
                if result is labels:
                    result = labels.copy()
                result.reshape(-1)[members[piece]] = following
                origin[following] = label
                following += 1
    return result, origin


def _stands(height: np.ndarray) -> bool:
    low, high = np.quantile(height, [0.03, 0.97])
    return bool(low < BEGINS_BELOW and high > LEAST_HEIGHT)


def _apart(
    first: np.ndarray,
    second: np.ndarray,
    label: int,
    flat: np.ndarray,
    raw: np.ndarray,
    camera: Camera,
    config: PerceptionConfig,
) -> bool:
    """Whether two pieces (pixels) are two things: something else fills the gap and nothing hides it."""
    start, end = closest_pair(flat[first], flat[second])
    if np.linalg.norm(end - start) < LEAST_GAP or covered(start, end, label, flat, raw, camera, config):
        return False
    along = np.linspace(0.0, 1.0, 33)[:, None]
    uv, _ = camera.project((1 - along) * start + along * end)
    column = np.clip(np.rint(uv[:, 0]).astype(int), 0, camera.width - 1)
    row = np.clip(np.rint(uv[:, 1]).astype(int), 0, camera.height - 1)
    return bool((raw[row * camera.width + column] != label).mean() > BETWEEN)


def _leaks(
    pieces: np.ndarray,
    flat: np.ndarray,
    raw: np.ndarray,
    height: np.ndarray,
    camera: Camera,
    config: PerceptionConfig,
) -> np.ndarray:
    """Share (P,) of each piece's border with other labels where it runs on; the table is not counted."""
    inner, outer = border_pairs(pieces)
    outside = raw[inner] != raw[outer]
    inner, outer = inner[outside], outer[outside]
    with np.errstate(invalid="ignore"):
        step = np.abs(flat[outer, 2] - flat[inner, 2])
        runs = (step < depth_jump(flat[inner, 2], camera, config)) & (height[outer] > config.plane_threshold)
    of = pieces.reshape(-1)[inner]
    count = int(pieces.max()) + 1
    return np.bincount(of, weights=runs, minlength=count) / np.maximum(1, np.bincount(of, minlength=count))
