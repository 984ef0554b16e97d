"""What perception hands on: one cleaned frame in the table frame, object by object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from mapping.compiled import compiled
from perception.camera import Camera

NOTHING, OTHER, SUPPORT = -1, -2, -3
"""What a pixel sees that sees no object: nothing measured, an obstacle without a label, a support."""
NO_PIXELS = np.empty(0, np.int64)


@dataclass(frozen=True)
class SupportPlane:
    """The plane objects stand on. normal . x + offset = 0 in the camera frame, normal towards the camera.

    inlier_ratio: share of the unlabelled measured pixels within `threshold` [m] of the plane.
    """

    normal: np.ndarray  # (3,)
    offset: float  # [m]
    inlier_ratio: float
    threshold: float  # [m]


@dataclass(frozen=True)
class ObservedObject:
    """The cleaned visible surface of one instance, in the table frame.

    points: (N, 3) float32 [m]; pixels: (N,) flat image indices of the same points;
    labelled: pixels that carried the label; dropped: those removed as invalid, flying or outliers.
    floor: height of the support that it stands on [m, table frame]; rests: whether that support is seen
    beside it. silhouette: (M,) flat indices of labelled pixels that measured nothing of it (no depth, or what
    is seen through it); guessed: (G,) those of them, inside its outline, at which Observation.guess has a
    depth, and guessed_points (G, 3) [m].
    """

    label: int
    name: str
    points: np.ndarray
    pixels: np.ndarray
    labelled: int
    dropped: int
    floor: float = 0.0
    rests: bool = True
    silhouette: np.ndarray = field(default_factory=lambda: NO_PIXELS)
    guessed: np.ndarray = field(default_factory=lambda: NO_PIXELS)
    guessed_points: np.ndarray = field(default_factory=lambda: np.empty((0, 3), np.float32))

    @cached_property
    def outline(self) -> np.ndarray:
        """(N + G, 3) float32 [m] its visible surface with what is guessed of it."""
        return np.concatenate([self.points, self.guessed_points]) if len(self.guessed) else self.points

    @cached_property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corner (3,) [m] of the visible surface, guessed parts too, in the table frame."""
        axes = np.ascontiguousarray(self.outline.T)  # NumPy is slow at the least of a few numbers a row
        return axes.min(1), axes.max(1)

    def reach(self, least: float, share: float) -> float:
        """How far beyond what is seen of it an object may go on [m]: `least`, or `share` of its visible width
        where that is more, so that the hidden part of a carton has as much room as that of a cup."""
        low, high = self.bounds
        return max(least, share * float((high - low)[:2].max()))


@dataclass(frozen=True)
class OtherSurface:
    """Measured surface near objects that carries no label and is no support: obstacles.

    points: (N, 3) float32 [m] in the table frame; pixels: (N,) flat image indices of the same points; bulky:
    (N,) bool, part of something wide enough to hide something, not of a rim that a tight mask leaves over.
    """

    points: np.ndarray = field(default_factory=lambda: np.empty((0, 3), np.float32))
    pixels: np.ndarray = field(default_factory=lambda: NO_PIXELS)
    bulky: np.ndarray = field(default_factory=lambda: np.empty(0, bool))


@dataclass(frozen=True)
class Skipped:
    """An object that could not be mapped, and why."""

    label: int
    name: str
    reason: str


@dataclass(frozen=True)
class Observation:
    """One frame, cleaned, in a frame tied to the support plane (z up, x away from the camera).

    depth: (H, W) float32 [m], NaN where missing or removed; labels: (H, W) uint16 after cleaning.
    T_table_camera: (4, 4); the table frame's origin lies on the support plane below the objects.
    objects: in the order their pixels are met in the image, so renumbering labels changes nothing.
    support: None when no plane was found; then the table frame is the camera frame. levels: heights [m] of
    all supports over that one, its own 0 among them. other: obstacles without a label, as far as they are
    near objects. seen: (H, W) int32 what each pixel sees: a label, OTHER, SUPPORT or NOTHING.
    guess: (H, W) float32 depth [m] guessed where an object's silhouette measured nothing, NaN elsewhere, or
    None.
    """

    camera: Camera
    depth: np.ndarray
    labels: np.ndarray
    T_table_camera: np.ndarray
    support: SupportPlane | None
    objects: tuple[ObservedObject, ...]
    skipped: tuple[Skipped, ...] = ()
    notes: tuple[str, ...] = field(default=())
    levels: tuple[float, ...] = (0.0,)
    other: OtherSurface = field(default_factory=OtherSurface)
    seen: np.ndarray | None = field(default_factory=lambda: None)  # no attribute of the class: see joint.py
    guess: np.ndarray | None = None

    @cached_property
    def memo(self) -> dict[Any, Any]:
        """What later steps worked out from this observation alone, by their names: a map of one view more
        has not to do it again."""
        return {}

    @cached_property
    def owner(self) -> np.ndarray:
        """Index of the object that each pixel shows, measured or guessed (H W,) int16; the number of objects
        for none, one more for an obstacle without a label."""
        owner = np.full(self.depth.size, len(self.objects), np.int16)
        for index, item in enumerate(self.objects):
            owner[item.pixels] = index
            owner[item.guessed] = index
        owner[self.other.pixels] = len(self.objects) + 1
        return owner

    def shows_object(self, pixels: np.ndarray) -> np.ndarray:
        """Whether pixels (N,), flat indices, show an object, measured or guessed: (N,) bool."""
        return np.asarray(self.owner[pixels] < len(self.objects))

    @property
    def first(self) -> Observation:
        """The view that pictures show: itself, or the first of several."""
        return self

    def at_border(self, item: ObservedObject, within: int = 1) -> bool:
        """Whether an object's pixels come nearer than `within` [px] to the image's border."""
        height, width = self.depth.shape
        rows, columns = np.divmod(item.pixels, width)
        ends = rows.min(), height - 1 - rows.max(), columns.min(), width - 1 - columns.max()
        return bool(min(ends) < within)

    def near_objects(self, points: np.ndarray, distance: float) -> np.ndarray:
        """Which points (N, 3) of the table frame lie within `distance` [m] of an object's box: (N,) bool."""
        return near_boxes(points, [item.bounds for item in self.objects], distance)


def near_boxes(
    points: np.ndarray, boxes: Sequence[tuple[np.ndarray, np.ndarray]], distance: float | Sequence[float]
) -> np.ndarray:
    """Which points (N, 3) lie within `distance` [m] of any box, given by its two corners (3,): (N,) bool.

    distance: one for all boxes, or one a box.
    """
    if not len(boxes):
        return np.zeros(len(points), bool)
    lows, highs = (np.array(corners, np.float32) for corners in zip(*boxes))
    reaches = np.broadcast_to(np.asarray(distance, np.float32), len(boxes))
    x, y, z = np.ascontiguousarray(np.asarray(points, np.float32).T)
    return np.asarray(_near_any(x, y, z, lows, highs, reaches.copy()))


@compiled
def _near_any(
    x: np.ndarray, y: np.ndarray, z: np.ndarray, lows: np.ndarray, highs: np.ndarray, reaches: np.ndarray
) -> np.ndarray:
    """Which points lie within its reach (K,) of a box lows..highs (K, 3): (N,) bool."""
    near = np.zeros(len(x), np.bool_)
    for k in range(len(reaches)):
        low, high, reach = lows[k], highs[k], reaches[k] ** 2
        for i in range(len(x)):
            # max(low - x, 0, x - high): one of the two is below 0.
            a = max(low[0] - x[i], x[i] - high[0], np.float32(0))
            b = max(low[1] - y[i], y[i] - high[1], np.float32(0))
            c = max(low[2] - z[i], z[i] - high[2], np.float32(0))
            near[i] |= a * a + b * b + c * c < reach
    return near
