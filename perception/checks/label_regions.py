"""What the labelled regions are in space: how far, how large, flat or not. Shared by the checks of labels
and units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from perception.grouping import group_by_label
from perception.quantiles import column_quantiles

ALL, SAMPLE = 12_000, 1_000
"""Points looked at of all labels together, and of each label."""
TRIM = (0.05, 0.95)
"""Sizes are taken between these quantiles, because masks bleed."""
FEWEST = 30
"""Labels with fewer measured pixels are not judged."""


@dataclass(frozen=True)
class LabelRegion:
    """The measured pixels of one label. points: (N, 3) [m, camera frame], some
    of them.

    distance: median depth [m]. sides: (3,) [m] along the principal axes, largest first. centre, normal: (3,)
    of the plane through the points. flat_share: share of the points within `thickness` of that plane.
    """

    label: int
    points: np.ndarray
    distance: float
    sides: np.ndarray
    centre: np.ndarray
    normal: np.ndarray

    def flat_share(self, thickness: float) -> float:
        """Share of the points within this distance [m] of the plane through them."""
        return float((np.abs((self.points - self.centre) @ self.normal) < thickness).mean())


def label_regions(points: np.ndarray, labels: np.ndarray) -> list[LabelRegion]:
    """The regions of all labels with enough measured pixels; points (H, W, 3) [m], labels (H, W)."""
    flat, raw = points.reshape(-1, 3), labels.reshape(-1)
    pixels = np.flatnonzero((raw > 0) & np.isfinite(flat[:, 2]))
    step = 1 + len(pixels) // ALL
    pixels = pixels[::step]
    found = []
    for label, group in group_by_label(raw[pixels]):
        if len(group) * step < FEWEST or len(group) < 3:
            continue
        own = flat[pixels[group[:: 1 + len(group) // SAMPLE]]].astype(np.float64)
        found.append(_region(int(label), own))
    return found


def _region(label: int, own: np.ndarray) -> LabelRegion:
    columns = np.ascontiguousarray(own.T)  # sums over all points take a fraction of the time
    low, middle, high = column_quantiles(own, TRIM[0], 0.5, TRIM[1])
    inner = columns[:, ((columns >= low[:, None]) & (columns <= high[:, None])).all(0)]
    if inner.shape[1] < 10:
        inner = columns
    centre = inner.mean(1)
    from_centre = inner - centre[:, None]
    axes = np.linalg.eigh(from_centre @ from_centre.T)[1]
    a, b = column_quantiles((own - centre) @ axes, *TRIM)
    order = np.argsort(a - b)
    return LabelRegion(label, own, float(middle[2]), (b - a)[order], centre, axes[:, 0])
