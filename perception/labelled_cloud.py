"""A labelled point cloud with class names and, where known, the sensor's position.

Knows points and labels in one frame [m]; must not know files or maps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mapping.errors import DataError
from mapping.samples import along_rays

UNLABELLED = -1


@dataclass(frozen=True)
class LabelledCloud:
    """Points with class labels.

    points: (N, 3) float64 [m], in the map's frame. labels: (N,) int64 index into names, UNLABELLED where
    there is none. names: of the classes. origin: (3,) [m] the sensor's position, None where it is not known.
    skipped: what was left out, with counts.
    """

    name: str
    points: np.ndarray
    labels: np.ndarray
    names: tuple[str, ...]
    origin: np.ndarray | None = None
    skipped: dict[str, int] = field(default_factory=dict)

    def labelled(self) -> LabelledCloud:
        """Only the points that have a label."""
        return self.at(self.labels != UNLABELLED)

    def at(self, rows: np.ndarray) -> LabelledCloud:
        """Some of the points: (N,) bool, or indices."""
        return replace(self, points=self.points[rows], labels=self.labels[rows])

    def moved(self, T_world_cloud: np.ndarray) -> LabelledCloud:
        """The same cloud in another frame; T_world_cloud: (4, 4)."""
        R, t = T_world_cloud[:3, :3], T_world_cloud[:3, 3]
        origin = None if self.origin is None else R @ self.origin + t
        return replace(self, points=self.points @ R.T + t, origin=origin)


def checked_cloud(
    name: str,
    points: np.ndarray,
    labels: np.ndarray,
    names: Sequence[str],
    origin: np.ndarray | None = None,
    skipped: dict[str, int] | None = None,
) -> LabelledCloud:
    """A cloud of arrays as a file gave them; points that are NaN or infinite are left out and counted.

    Raises DataError for other shapes, counts that differ, labels beyond the names, and clouds without points.
    """
    points, labels = np.asarray(points, np.float64), np.asarray(labels)
    if points.ndim != 2 or points.shape[1] != 3:
        raise DataError(f"{name}: points must have shape (N, 3), got {points.shape}")
    if labels.shape != (len(points),) or labels.dtype.kind not in "iub":
        raise DataError(
            f"{name}: {len(points)} points but labels of shape {labels.shape} and type {labels.dtype}; "
            "wanted one whole number for each point"
        )
    labels = labels.astype(np.int64)
    if len(labels) and (labels.min() < UNLABELLED or labels.max() >= len(names)):
        raise DataError(f"{name}: labels {labels.min()}..{labels.max()}, but there are {len(names)} classes")
    finite = np.isfinite(points).all(axis=1)
    counts = dict(skipped or {})
    if not finite.all():
        counts["points that are not finite"] = int((~finite).sum())
    if not finite.any():
        raise DataError(f"{name}: no finite point in this cloud; is the file empty?")
    return LabelledCloud(name, points[finite], labels[finite], tuple(names), origin, counts)


def free_points(cloud: LabelledCloud, step: float, margin: float, rng: np.random.Generator) -> np.ndarray:
    """Points (M, 3) [m] in the free space along a cloud's beams: one in each `step` up to `margin` before.

    Raises DataError when the sensor's position is not known.
    """
    if cloud.origin is None:
        raise DataError(f"{cloud.name}: free space needs the sensor's position, and the file does not say it")
    return along_rays(cloud.origin, cloud.points, step, margin, rng)
