"""One frame to one Observation: clean the depth, find the table, clean each object. The perception stage."""

from __future__ import annotations

import numpy as np

from mapping.errors import FrameError
from perception.camera import Camera, transform
from perception.checks.label_regions import LabelRegion
from perception.checks.scene import check_depth, check_support, screen_labels, split_numbers
from perception.cleaning import clean_labels
from perception.config import PerceptionConfig
from perception.depth_edges import remove_flying_pixels
from perception.frame import Frame
from perception.grouping import masks_of
from perception.observation import (
    NO_PIXELS,
    OTHER,
    Observation,
    ObservedObject,
    OtherSurface,
    Skipped,
    SupportPlane,
    near_boxes,
)
from perception.quantiles import column_quantiles
from perception.segmentation import segment
from perception.silhouettes import silhouettes
from perception.support_plane import find_support_plane
from perception.supports import Levels, find_levels
from perception.unlabelled import bulky, what_pixels_see

LITTLE_MEASURED = 0.5
"""An object less of whose mask is measured than this is named in a note."""
NOISY = 0.25
"""What is smaller than its depth noise over this share has no shape that could be mapped."""
SCALE_POINTS = 2000
"""Visible points of an object from which its size and distance are taken."""
BEYOND = 0.005
"""A guessed surface lies no farther than this beyond 98 % of what was measured of its object [m]."""
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
    depth, found_odd = check_depth(frame, seed)
    notes += found_odd
    depth = remove_flying_pixels(depth, camera, config) if config.remove_flying_pixels else depth
    points = camera.back_project(depth)
    labels = frame.labels
    aside: list[Skipped] = []
    regions: list[LabelRegion] = []
    if labels is not None:
        labels, regions, aside, found_odd = screen_labels(frame, points, config)
        notes += found_odd
    if labels is None:
        rough = find_support_plane(points, None, config, rng) if config.use_plane else None
        labels = segment(points, rough, camera, config)
        notes.append("no labels given: objects come from the built-in plane-and-cluster segmentation")
        if not labels.any():
            raise FrameError(f"{frame.source}: no labels given and the depth image shows no object by itself")
    support = find_support_plane(points, labels, config, rng) if config.use_plane else None
    if support is None:
        notes.append("no support plane: the table frame is the camera frame")
    levels = Levels((0.0,), {}, frozenset())
    if support is not None:
        notes += check_support(frame, regions, support)
        if frame.labels is not None:
            labels, frame, found_odd = split_numbers(frame, points, labels, regions, support, config)
            notes += found_odd
    masks = masks_of(labels)
    measured = _measured(masks, depth)
    if support is not None:
        levels = find_levels(points, labels, measured, support, camera, config)
    cleaned = clean_labels(points, labels, measured, support, camera, config, levels.floors)
    found, skipped = _split_objects(frame, masks, cleaned, points, config)
    skipped += aside
    if not found:
        reasons = "; ".join(f"{item.name}: {item.reason}" for item in skipped)
        raise FrameError(f"{frame.source}: no object is left to map ({reasons})")
    for item in skipped:
        if (mask := masks.get(item.label)) is not None:  # an obstacle like any other
            own = cleaned.reshape(-1)[mask] > 0
            masks[item.label] = mask[~own]
            cleaned.reshape(-1)[mask[own]] = 0
    unmeasured, guess = silhouettes(depth, masks, cleaned, config.minimum_pixels)
    depth, points = _without(depth, points, unmeasured)
    flat = points.reshape(-1, 3)
    surfaces = [flat.take(pixels, axis=0) for _, pixels, _ in found]
    T_table_camera = _table_frame(support, np.concatenate(surfaces))
    objects = []
    for (label, pixels, labelled), surface in zip(found, surfaces):
        silhouette = unmeasured.get(label, NO_PIXELS)
        guessed = silhouette[np.isfinite(guess.reshape(-1)[silhouette])]
        own = transform(T_table_camera, surface)
        rays = camera.rays.reshape(-1, 3)[guessed]
        places = transform(T_table_camera, rays * guess.reshape(-1)[guessed, None])
        stray = _astray(own, places) if len(places) else np.zeros(0, bool)
        guess.reshape(-1)[guessed[stray]] = np.nan
        objects.append(
            ObservedObject(
                label=label,
                name=frame.name_of(label),
                points=own,
                pixels=pixels,
                labelled=labelled,
                dropped=labelled - len(pixels),
                floor=levels.floors.get(label, 0.0),
                rests=label in levels.found,
                silhouette=silhouette,
                guessed=guessed[~stray],
                guessed_points=places[~stray],
            )
        )
        if len(pixels) < LITTLE_MEASURED * labelled:
            notes.append(
                f"{frame.name_of(label)}: only {100 * len(pixels) / labelled:.0f} % of its {labelled} "
                "labelled pixels measured its surface; the rest of its shape is guessed"
            )
    seen = what_pixels_see(points, cleaned, support, levels.heights, config)
    return Observation(
        camera,
        depth,
        cleaned,
        T_table_camera,
        support,
        tuple(objects),
        tuple(skipped),
        tuple(notes),
        levels=levels.heights,
        other=_obstacles(objects, points, seen, camera, T_table_camera, config),
        seen=seen,
        guess=guess if np.isfinite(guess).any() else None,
    )


def _astray(points: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Which guessed places (M, 3) lie beyond nearly all of what was measured of their object: (M,) bool.

    Holes at the rim of a mask take after stray pixels beside them. points: (N, 3) [m] measured, same frame.
    """
    low, high = column_quantiles(points, 0.01, 0.99)
    return np.asarray(((places < low - BEYOND) | (places > high + BEYOND)).any(1))


def _without(
    depth: np.ndarray, points: np.ndarray, unmeasured: dict[int, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Depth (H, W) and points (H, W, 3) without what was measured through silhouettes."""
    through = np.concatenate([NO_PIXELS, *unmeasured.values()])
    if not np.isfinite(depth.reshape(-1)[through]).any():
        return depth, points
    depth, points = depth.copy(), points.copy()
    depth.reshape(-1)[through] = np.nan
    points.reshape(-1, 3)[through] = np.nan
    return depth, points


def _obstacles(
    objects: list[ObservedObject],
    points: np.ndarray,
    seen: np.ndarray,
    camera: Camera,
    T_table_camera: np.ndarray,
    config: PerceptionConfig,
) -> OtherSurface:
    """What is seen of obstacles near objects. points: (H, W, 3) [m] in the camera frame; seen: (H, W)."""
    pixels = np.flatnonzero(seen == OTHER)
    local = transform(T_table_camera, points.reshape(-1, 3).take(pixels, axis=0))
    near = near_boxes(local, [item.bounds for item in objects], config.other_reach)
    wide = bulky(seen, points[..., 2], float(camera.K[0, 0])).reshape(-1)[pixels]
    return OtherSurface(local[near], pixels[near], wide[near])


def _measured(masks: dict[int, np.ndarray], depth: np.ndarray) -> dict[int, np.ndarray]:
    """The pixels of each mask that have a depth, of those that have any. depth: (H, W) [m]."""
    flat = depth.reshape(-1)
    measured = {label: pixels[np.isfinite(flat.take(pixels))] for label, pixels in masks.items()}
    return {label: pixels for label, pixels in measured.items() if len(pixels)}


def _split_objects(
    frame: Frame,
    masks: dict[int, np.ndarray],
    cleaned: np.ndarray,
    points: np.ndarray,
    config: PerceptionConfig,
) -> tuple[list[tuple[int, np.ndarray, int]], list[Skipped]]:
    """(label, pixels, labelled count) of each object and the skipped ones, in the order of the raw image."""
    kept = cleaned.reshape(-1) > 0
    found, skipped = [], []
    for label, mask in masks.items():
        pixels = mask[kept.take(mask)]
        if len(pixels) < config.minimum_pixels:
            reason = (
                f"{len(pixels)} valid pixels of {len(mask)} labelled, "
                f"at least {config.minimum_pixels} are needed"
            )
            skipped.append(Skipped(label, frame.name_of(label), reason))
            continue
        few = pixels[:: 1 + len(pixels) // SCALE_POINTS]
        if (too := _out_of_scale(points.reshape(-1, 3)[few], config)) is not None:
            skipped.append(Skipped(label, frame.name_of(label), too))
        else:
            found.append((label, pixels, len(mask)))
    return found, skipped


def _out_of_scale(points: np.ndarray, config: PerceptionConfig) -> str | None:
    """Why an object with visible points (N, 3) [m] is too large or too far to be mapped, or None."""
    low, middle, high = column_quantiles(points, 0.01, 0.5, 0.99)
    size, distance = float((high - low).max()), float(middle[2])
    if size > config.largest_object:
        return f"{size:.2f} m in size, at most {config.largest_object:g} m are mapped (largest_object)"
    noise = config.depth_noise * distance**2
    if noise > NOISY * size:
        return (
            f"{distance:.1f} m away, where depth is uncertain by {100 * noise:.0f} cm (depth_noise): too far "
            f"for a thing of {100 * size:.0f} cm"
        )
    return None


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
