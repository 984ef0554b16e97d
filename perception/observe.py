"""One frame to one Observation: clean the depth, find the table, clean each object. The perception stage."""

from __future__ import annotations

import numpy as np

from mapping.errors import FrameError
from perception.camera import transform
from perception.cleaning import clean_labels
from perception.config import PerceptionConfig
from perception.depth_edges import remove_flying_pixels
from perception.frame import Frame
from perception.grouping import group_by_label
from perception.observation import Observation, ObservedObject, Skipped, SupportPlane
from perception.segmentation import segment
from perception.support_plane import find_support_plane

HORIZONTAL_LEAST = 0.15
"""Below this horizontal share of the viewing direction the camera looks straight down."""


def observe(frame: Frame, config: PerceptionConfig | None = None, seed: int = 0) -> Observation:
    """Clean a frame and express it in the table frame.

    Works in the camera frame alone, so the choice of world frame has no influence.
    Raises FrameError when no object is left.
    """
    config = config or PerceptionConfig()
    rng = np.random.default_rng(seed)
    notes: list[str] = list(frame.notes)
    camera = frame.camera
    depth = remove_flying_pixels(frame.depth, camera, config) if config.remove_flying_pixels else frame.depth
    points = camera.back_project(depth)
    labels = frame.labels
    if labels is None:
        rough = find_support_plane(points, None, config, rng) if config.use_plane else None
        labels = segment(points, rough, camera, config)
        notes.append("no labels given: objects come from the built-in plane-and-cluster segmentation")
        if not labels.any():
            raise FrameError(f"{frame.source}: no labels given and the depth image shows no object by itself")
    support = find_support_plane(points, labels, config, rng) if config.use_plane else None
    if support is None:
        notes.append("no support plane: the table frame is the camera frame")
    cleaned = clean_labels(points, labels, support, camera, config)
    found, skipped = _split_objects(frame, labels, cleaned, config)
    if not found:
        reasons = "; ".join(f"{item.name}: {item.reason}" for item in skipped)
        raise FrameError(f"{frame.source}: no object is left to map ({reasons})")
    flat = points.reshape(-1, 3)
    everything = np.concatenate([flat[pixels] for _, pixels, _ in found])
    T_table_camera = _table_frame(support, everything)
    objects = tuple(
        ObservedObject(
            label=label,
            name=frame.name_of(label),
            points=transform(T_table_camera, flat[pixels]),
            pixels=pixels,
            labelled=labelled,
            dropped=labelled - len(pixels),
        )
        for label, pixels, labelled in found
    )
    for item in skipped:
        cleaned[cleaned == item.label] = 0
    return Observation(camera, depth, cleaned, T_table_camera, support, objects, tuple(skipped), tuple(notes))


def _split_objects(
    frame: Frame, labels: np.ndarray, cleaned: np.ndarray, config: PerceptionConfig
) -> tuple[list[tuple[int, np.ndarray, int]], list[Skipped]]:
    """(label, pixels, labelled count) of each object and the skipped ones, in the order of the raw image."""
    raw, clean = labels.reshape(-1), cleaned.reshape(-1)
    labelled = np.flatnonzero(raw > 0)
    kept = np.flatnonzero(clean > 0)
    pixels_of = {label: kept[group] for label, group in group_by_label(clean[kept])}
    found, skipped = [], []
    for label, group in group_by_label(raw[labelled]):
        pixels = pixels_of.get(label, kept[:0])
        if len(pixels) < config.minimum_pixels:
            reason = (
                f"{len(pixels)} valid pixels of {len(group)} labelled, "
                f"at least {config.minimum_pixels} are needed"
            )
            skipped.append(Skipped(label, frame.name_of(label), reason))
        else:
            found.append((label, pixels, len(group)))
    return found, skipped


def _table_frame(support: SupportPlane | None, points: np.ndarray) -> np.ndarray:
    """T_table_camera (4, 4): z along the normal, x along the view, origin below the objects' centroid."""
    T = np.eye(4)
    if support is None:
        return T
    z = support.normal / np.linalg.norm(support.normal)
    x = np.array([0.0, 0.0, 1.0]) - z[2] * z
    if np.linalg.norm(x) < HORIZONTAL_LEAST:
        # Looking straight down, the image's upward direction is "away", as it is for any tilted camera.
        x = np.array([0.0, -1.0, 0.0]) + z[1] * z
    x /= np.linalg.norm(x)
    centroid = np.array([column.mean(dtype=np.float64) for column in points.T])
    origin = centroid - (z @ centroid + support.offset) * z
    T[:3, :3] = np.stack([x, np.cross(z, x), z])
    T[:3, 3] = -T[:3, :3] @ origin
    return T
