"""What a mask says beyond depth: labelled pixels that measured nothing of their object are its silhouette.

Knows one image's depth and labels; knows nothing of space. Shiny, black and transparent parts give no depth,
or that of what is seen through them.
"""

from __future__ import annotations

import numpy as np

from perception.thin_plate import block_means, thin_plate

SEEN_THROUGH = 0.25
"""Where more than this share of a mask, inside its object's outline, measured something else, it is seen
through; less is a hole, such as a handle's."""
SEEN_THROUGH_WHOLE = 0.7
"""A mask with more than this share of such pixels, and next to none of its own, is seen through."""
DEEP = 2.5
"""Holes with pixels further than this from a surface pixel are deep [px]."""
PLATE_BLOCKS = 120
"""A surface with its holes is cut into about this many blocks to be interpolated."""


def silhouettes(
    depth: np.ndarray, masks: dict[int, np.ndarray], cleaned: np.ndarray, least: int
) -> tuple[dict[int, np.ndarray], np.ndarray]:
    """Pixels (flat indices) of each label that belong to its silhouette alone, and the depth guessed there.

    depth: (H, W) float32 [m], NaN where missing; masks: label -> ascending flat indices of its pixels, as
    given; cleaned: (H, W), 0 where a pixel is not its object's surface; least: an object with fewer surface
    pixels has none. The guess (H, W) float32 is NaN wherever nothing is guessed: it is taken inside an
    object's outline only, from its surface around.
    """
    kept = cleaned.reshape(-1)
    measured = np.isfinite(depth).reshape(-1)
    guess = np.full(depth.shape, np.nan, np.float32)
    found: dict[int, np.ndarray] = {}
    for label, whole in masks.items():
        surface = kept[whole] > 0
        own, lost = whole[surface], whole[~surface]
        seen = measured[lost]
        if len(own) < least:
            everything = np.count_nonzero(seen) > SEEN_THROUGH_WHOLE * len(whole)
            found[label] = lost if everything else lost[~seen]
            continue
        inside = _inside_outline(own, lost, depth.shape)
        through = seen & inside
        if np.count_nonzero(through) <= SEEN_THROUGH * len(whole):
            through[:] = False
        found[label] = lost[~seen | through]
        hole = lost[(~seen & inside) | through]
        if len(hole):
            guess.reshape(-1)[hole] = _filled(depth, own, hole)
    return {label: pixels for label, pixels in found.items() if len(pixels)}, guess


def _inside_outline(own: np.ndarray, pixels: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Which pixels lie inside the convex outline of an object's own pixels, both flat indices that ascend."""
    import cv2

    # The first and the last pixel of every row say as much of the outline as all of them.
    row_starts = np.arange(own[0] // shape[1], own[-1] // shape[1] + 2) * shape[1]
    ends = np.searchsorted(own, row_starts)
    filled = ends[1:] > ends[:-1]
    rows, columns = np.divmod(own[np.concatenate([ends[:-1][filled], ends[1:][filled] - 1])], shape[1])
    top, left = rows.min(), columns.min()
    mask = np.zeros((rows.max() - top + 1, columns.max() - left + 1), np.uint8)
    hull = cv2.convexHull(np.stack([columns - left, rows - top], 1).astype(np.int32))
    cv2.fillConvexPoly(mask, hull, 1)
    rows, columns = np.divmod(pixels, shape[1])
    rows, columns = rows - top, columns - left
    within = (rows >= 0) & (columns >= 0) & (rows < mask.shape[0]) & (columns < mask.shape[1])
    within[within] = mask[rows[within], columns[within]] > 0
    return within


def _filled(depth: np.ndarray, own: np.ndarray, hole: np.ndarray) -> np.ndarray:
    """Depth (M,) [m] at the pixels `hole` (M,) from the surface pixels `own` (N,), all flat indices.

    Inverse depth is what is interpolated: it is linear in the image where the surface is flat. In deep holes
    a thin plate goes on as the surface around does; elsewhere the nearest pixel is good enough.
    """
    import cv2

    rows, columns = np.divmod(np.concatenate([own, hole]), depth.shape[1])
    top, left = rows.min(), columns.min()
    shape = rows.max() - top + 1, columns.max() - left + 1
    index = (rows - top) * shape[1] + columns - left
    inverse = 1 / depth.reshape(-1)[own]
    unknown = np.ones(shape, np.uint8)
    unknown.reshape(-1)[index[: len(own)]] = 0
    distance, nearest = cv2.distanceTransformWithLabels(
        unknown, cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
    )
    into = index[len(own) :]
    if distance.reshape(-1)[into].max() > DEEP:
        # Means over blocks of pixels: fewer to solve for, and less noise.
        side = max(1, int(np.sqrt(len(rows) / PLATE_BLOCKS)))
        places, values = block_means(rows[: len(own)], columns[: len(own)], inverse, side)
        answer = thin_plate(places, values, np.stack([rows, columns], axis=1)[len(own) :])
    else:
        value = np.zeros(int(nearest.max()) + 1, np.float32)
        value[nearest.reshape(-1)[index[: len(own)]]] = inverse
        answer = value[nearest.reshape(-1)[into]]
    return (1 / np.clip(answer, inverse.min(), inverse.max())).astype(np.float32)
