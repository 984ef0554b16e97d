"""Labels that are no things on a table: the table itself, what is far behind, walls and floors. Before the
plane.

They become background, so that the support plane may use them, and are listed with the reason.
"""

from __future__ import annotations

import numpy as np

from perception.checks.label_regions import LabelRegion
from perception.config import PerceptionConfig

FAR_MORE, FAR_TIMES = 2.5, 3.0
"""What is this much [m] and this many times farther than the nearest thing is too far to be mapped with
it."""
LARGE, LARGE_TIMES = 1.2, 4.0
"""What is this long [m] and this many times the usual thing's length is too large to be mapped with it."""
TABLE_SIDES = (0.35, 0.18)
"""A labelled table shows at least this much of itself [m]."""
TABLE_FLAT = 0.85
"""So much of its points lie in one plane."""
STANDS_WITHIN = (-0.02, 0.05)
"""What stands on a table has its lowest points at this height above it [m]."""
STANDING = 0.5
"""A labelled table carries at least this share of the other things."""
TRAY_HEIGHT = 0.35
"""A flat thing this little [m] above another plane is a tray or a book, not the table."""
TRAY_SHARE = 0.2
"""... when so much of what is measured beside it, and carries no label, lies in that plane."""
BESIDE = 0.2
"""Beside it is within this distance of it [m]."""
BIN = 0.02
"""Height of the slices in which another plane is looked for [m]."""


def set_aside(
    points: np.ndarray, labels: np.ndarray, regions: list[LabelRegion], config: PerceptionConfig
) -> tuple[np.ndarray, list[tuple[int, str]]]:
    """Labels (H, W) without scenery, and (label, reason) of what was set aside.

    points: (H, W, 3) [m] in the camera frame; regions: of the labels. Never sets everything aside.
    """
    reasons = {**_far(regions), **_large(regions)}
    near = [item for item in regions if item.label not in reasons]
    for item in regions:
        if item.label in reasons and reasons[item.label].startswith("far"):
            continue
        others = [other for other in near if other.label != item.label]
        if others and _is_table(item, others, points, labels, config):
            reasons[item.label] = (
                f"covers the support plane ({item.sides[0]:.2f} x {item.sides[1]:.2f} m, other things "
                f"stand on it): taken as "
                "the support, not as an object"
            )
    if not reasons or len(reasons) == len(regions):
        return labels, []
    kept = np.where(np.isin(labels, list(reasons)), 0, labels).astype(labels.dtype)
    return kept, [(item.label, reasons[item.label]) for item in regions if item.label in reasons]


def _far(regions: list[LabelRegion]) -> dict[int, str]:
    if not regions:
        return {}
    nearest = min(item.distance for item in regions)
    limit = max(nearest + FAR_MORE, FAR_TIMES * nearest)
    return {
        item.label: f"far behind the others: {item.distance:.1f} m away, the nearest {nearest:.1f} m"
        for item in regions
        if item.distance > limit
    }


def _large(regions: list[LabelRegion]) -> dict[int, str]:
    if len(regions) < 2:
        return {}
    usual = float(np.median([item.sides[0] for item in regions if item.sides[0] < LARGE] or [np.inf]))
    return {
        item.label: f"too large to be mapped with others: {item.sides[0]:.1f} m long, they {usual:.2f} m"
        for item in regions
        if item.sides[0] > max(LARGE, LARGE_TIMES * usual)
    }


def _is_table(
    item: LabelRegion,
    others: list[LabelRegion],
    points: np.ndarray,
    labels: np.ndarray,
    config: PerceptionConfig,
) -> bool:
    """Whether a label is the plane that the others stand on, and not a tray or a book on it."""
    if item.sides[0] < TABLE_SIDES[0] or item.sides[1] < TABLE_SIDES[1]:
        return False
    thickness = config.plane_threshold + 2 * config.depth_noise * item.distance**2
    if item.flat_share(thickness) < TABLE_FLAT:
        return False
    normal = -item.normal if item.normal @ item.centre > 0 else item.normal  # towards the camera
    standing = []
    for other in others:
        height = (other.points - item.centre) @ normal
        lowest = float(np.quantile(height, 0.05))
        standing.append(STANDS_WITHIN[0] - thickness < lowest < STANDS_WITHIN[1] and np.median(height) > 0)
    if np.mean(standing) < STANDING:
        return False
    return not _on_another(item, normal, thickness, points, labels)


def _on_another(
    item: LabelRegion, normal: np.ndarray, thickness: float, points: np.ndarray, labels: np.ndarray
) -> bool:
    """Whether a plane lies close below the region, in what carries no label."""
    bare = points[(labels == 0) & np.isfinite(points[..., 2])]
    bare = bare[:: 1 + len(bare) // 20_000]
    low, high = item.points.min(0) - BESIDE, item.points.max(0) + BESIDE
    bare = bare[((bare > low) & (bare < high)).all(1)]
    if len(bare) < 50:
        return False
    height = (bare - item.centre) @ normal
    below = height[(height < -max(thickness, 0.008)) & (height > -TRAY_HEIGHT)]
    level = float((np.abs(height) < thickness).mean())
    if below.size == 0:
        return False
    count = np.histogram(below, np.arange(-TRAY_HEIGHT, BIN, BIN))[0]
    return bool(count.max() / len(bare) > max(TRAY_SHARE, level))
