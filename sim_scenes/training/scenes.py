"""Many quick scenes for training the occlusion prior: shapes at rest on a table, without a physics engine.

Shapes stand, lie on a face of their convex hull or lean, and fall straight down onto what is there already.
Only depth and labels are rendered.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from perception.camera import Camera, look_at
from perception.frame import Frame
from perception.ray_casting import ray_scene, tensor
from sim_scenes.sensor_noise import SensorNoiseConfig, noisy_depth, noisy_labels
from sim_scenes.training.shapes import TrainingShape

DRAWS = 30
"""Places tried for a shape that should not touch the others."""
ABOVE = 2.0
"""Height [m] from which shapes fall."""
LEAST_PIXELS = 60
"""Shapes that show fewer pixels stay in the scene without a label, as clutter does."""


@dataclass(frozen=True)
class SceneConfig:
    """How training scenes vary."""

    objects: tuple[int, int] = (1, 12)
    """Fewest and most shapes."""
    upright: float = 0.42
    """Share of shapes that stand as modelled."""
    upside_down: float = 0.12
    """Share of shapes that stand on their head."""
    leaning: float = 0.12
    """Share of shapes in any orientation, as if leaning on something."""
    piled: float = 0.3
    """Share of shapes that may fall onto others."""
    spread_m: float = 0.22
    """Shapes lie within this distance of the table's centre."""
    distance_m: tuple[float, float] = (0.4, 1.2)
    """Nearest and farthest camera."""
    nearest_m: float = 0.15
    """Scenes with anything nearer to the camera are drawn again: no depth camera sees that."""
    elevation_deg: tuple[float, float] = (14.0, 75.0)
    """Lowest and highest viewing angle."""
    table_m: tuple[float, float] = (0.35, 1.5)
    """Smallest and largest half side of the table; beyond it nothing is measured."""
    widths_px: tuple[int, ...] = (320, 400, 480, 640)
    """Image widths, at an aspect of 4 to 3."""
    focal_share: tuple[float, float] = (0.8, 1.15)
    """Focal length as a share of the image width."""
    off_centre: float = 0.3
    """Share of scenes that the camera does not look at the middle of: the image's border cuts objects."""
    target_m: tuple[float, float] = (0.05, 0.3)
    """The camera looks at a point within this distance of the middle [m]: usually, and off centre."""
    noisy: float = 0.55
    """Share of scenes with sensor noise."""
    noisy_labels: float = 0.35
    """Share of scenes with wrong label borders."""
    noise_scale: float = 0.7
    """The sensor's errors vary by up to this in the logarithm."""
    waves: float = 0.006
    """Largest smooth error of depth at 1 m [m]."""
    rounding_px: float = 3.0
    """Largest distance over which creases are rounded."""
    shadowed: float = 0.7
    """Share of noisy scenes in which depth is lost where a second imager cannot see."""
    shadow_m: tuple[float, float] = (0.03, 0.09)
    """Least and greatest distance of the second imager."""


@dataclass(frozen=True)
class TrainingScene:
    """A frame and, by label, its true shapes in the world frame (table top at z = 0)."""

    frame: Frame
    shapes: dict[int, TrainingShape]


def make_training_scene(
    draw: Callable[[np.random.Generator], TrainingShape],
    rng: np.random.Generator,
    config: SceneConfig | None = None,
) -> TrainingScene:
    """One scene of shapes from `draw`, seen by a random camera."""
    config = config or SceneConfig()
    shapes: list[TrainingShape] = []
    for _ in range(rng.integers(config.objects[0], config.objects[1] + 1)):
        shapes.append(_place(draw(rng), shapes, rng, config))
    camera = _camera(rng, config)
    depth, labels = _render(shapes, camera, rng.uniform(*config.table_m))
    visible = np.bincount(labels.ravel(), minlength=len(shapes) + 1)
    kept = {label: shape for label, shape in enumerate(shapes, 1) if visible[label] >= LEAST_PIXELS}
    labels[~np.isin(labels, list(kept))] = 0
    too_near = np.nanmin(depth, initial=np.inf) < config.nearest_m
    if not kept or too_near:
        return make_training_scene(draw, rng, config)
    if rng.random() < config.noisy_labels:
        labels = noisy_labels(labels, rng)
    if rng.random() < config.noisy:
        depth = noisy_depth(depth, camera, rng, _sensor(rng, config))
    if not labels.any():
        return make_training_scene(draw, rng, config)
    return TrainingScene(Frame(depth, camera, labels=labels, source="training scene"), kept)


def inside(shape: TrainingShape, points: np.ndarray) -> np.ndarray:
    """Which points (N, 3) lie inside a shape (N,) bool."""
    result = np.zeros(len(points), bool)
    for part in shape.parts:
        low, high = part.bounds
        rows = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
        if len(rows) == 0:
            continue
        scene = ray_scene([(part.vertices, part.faces)])
        result[rows] |= scene.compute_occupancy(tensor(points[rows])).numpy() > 0.5
    return result


def _place(
    shape: TrainingShape, others: Sequence[TrainingShape], rng: np.random.Generator, config: SceneConfig
) -> TrainingShape:
    """A copy of the shape at rest on the table or on the others."""
    vertices = np.concatenate([part.vertices for part in shape.parts])
    turn = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi)).as_matrix()
    roll = rng.random()
    if roll < config.leaning:
        rotation = Rotation.random(random_state=rng).as_matrix()
    elif roll < config.leaning + config.upright:
        rotation = turn
    elif roll < config.leaning + config.upright + config.upside_down:
        rotation = turn @ np.diag([1.0, -1.0, -1.0])
    else:
        rotation = turn @ _resting_rotation(vertices, rng)
    vertices = vertices @ rotation.T
    radius = np.linalg.norm(vertices[:, :2] - vertices[:, :2].mean(0), axis=1).max()
    middle = np.append(vertices[:, :2].mean(0), vertices[:, 2].min())
    taken = [(_centre(other), _radius(other)) for other in others]
    for _ in range(DRAWS):
        distance, angle = config.spread_m * np.sqrt(rng.random()), rng.uniform(0, 2 * np.pi)
        place = distance * np.array([np.cos(angle), np.sin(angle), 0.0])
        if all(np.linalg.norm(place[:2] - centre) > radius + reach for centre, reach in taken):
            break
        if rng.random() < config.piled:
            break
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, place - middle
    moved = _moved(shape, T)
    below = [
        other
        for other, (centre, reach) in zip(others, taken)
        if np.linalg.norm(place[:2] - centre) <= radius + reach
    ]
    if below:
        T = np.eye(4)
        T[2, 3] = _fall(moved, below)
        moved = _moved(moved, T)
    return moved


def _resting_rotation(vertices: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A rotation (3, 3) that puts a stable face of the convex hull down; likelier the larger it is."""
    hull = trimesh.convex.convex_hull(vertices)
    normals, areas = np.asarray(hull.face_normals), np.asarray(hull.area_faces)
    corners = hull.triangles  # (F, 3, 3)
    centre = hull.center_mass
    foot = centre + np.einsum("fi,fi->f", corners[:, 0] - centre, normals)[:, None] * normals
    edges = np.roll(corners, -1, axis=1) - corners
    side = np.einsum("fki,fi->fk", np.cross(edges, foot[:, None] - corners), normals)
    stable = (side > -1e-4 * np.sqrt(areas)[:, None]).all(axis=1)
    weights = areas * stable
    if weights.sum() <= 0:
        weights = areas
    down = normals[rng.choice(len(normals), p=weights / weights.sum())]
    rotation, _ = Rotation.align_vectors([[0, 0, -1]], [down])
    return rotation.as_matrix()


def _fall(shape: TrainingShape, others: Sequence[TrainingShape]) -> float:
    """Height at which a shape that stands on z = 0 comes to rest when it falls onto the others."""

    def gap(below: Sequence[TrainingShape], points: np.ndarray, direction: float) -> float:
        scene = ray_scene((part.vertices, part.faces) for item in below for part in item.parts)
        rays = np.zeros((len(points), 6), np.float32)
        rays[:, :3] = points
        rays[:, 5] = direction
        return float(scene.cast_rays(tensor(rays))["t_hit"].numpy().min())

    own = np.concatenate([part.vertices for part in shape.parts])
    own[:, 2] += ABOVE
    theirs = np.concatenate([part.vertices for other in others for part in other.parts])
    free = min(gap(others, own, -1.0), gap([shape], theirs - [0, 0, ABOVE], 1.0), ABOVE)
    return ABOVE - free


def _centre(shape: TrainingShape) -> np.ndarray:
    return np.concatenate([part.vertices for part in shape.parts])[:, :2].mean(0)


def _radius(shape: TrainingShape) -> float:
    flat = np.concatenate([part.vertices for part in shape.parts])[:, :2]
    return float(np.linalg.norm(flat - flat.mean(0), axis=1).max())


def _moved(shape: TrainingShape, T: np.ndarray) -> TrainingShape:
    parts = [part.copy() for part in shape.parts]
    for part in parts:
        part.apply_transform(T)
    return TrainingShape(shape.family, tuple(parts))


def _camera(rng: np.random.Generator, config: SceneConfig) -> Camera:
    width = int(rng.choice(config.widths_px))
    height = width * 3 // 4
    focal = width * rng.uniform(*config.focal_share)
    K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    azimuth, elevation = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(*config.elevation_deg))
    reach = config.target_m[int(rng.random() < config.off_centre)]
    target = np.array([*rng.uniform(-reach, reach, 2), 0.04])
    away = np.array(
        [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)]
    )
    return Camera(K, width, height, look_at(target + rng.uniform(*config.distance_m) * away, target))


def _sensor(rng: np.random.Generator, config: SceneConfig) -> SensorNoiseConfig:
    """A random sensor, from a good one to a poor one."""
    usual = SensorNoiseConfig()
    scale = np.exp(rng.uniform(-config.noise_scale, config.noise_scale, 2))
    shadow = rng.uniform(*config.shadow_m) * rng.choice([-1, 1]) * (rng.random() < config.shadowed)
    return SensorNoiseConfig(
        axial=usual.axial * scale[0],
        disparity_step=usual.disparity_step * scale[1],
        waves=config.waves * rng.random(),
        rounding_px=config.rounding_px * rng.random(),
        shadow_m=shadow,
    )


def _render(shapes: Sequence[TrainingShape], camera: Camera, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Depth (H, W) [m] and labels (H, W) uint16, k = shape k - 1, on a table of half side `reach` [m]."""
    table = trimesh.creation.box([2 * reach, 2 * reach, 0.02])
    table.apply_translation([0, 0, -0.01])
    parts = [(0, table), *((label, part) for label, shape in enumerate(shapes, 1) for part in shape.parts)]
    scene = ray_scene((part.vertices, part.faces) for _, part in parts)
    owner = [label for label, _ in parts]
    T = camera.T_world_camera.astype(np.float32)
    directions = camera.rays @ T[:3, :3].T
    origins = np.broadcast_to(T[:3, 3], directions.shape)
    hits = scene.cast_rays(tensor(np.concatenate([origins, directions], axis=-1)))
    depth = hits["t_hit"].numpy()
    seen = np.isfinite(depth)
    labels = np.array(owner, np.uint16)[np.where(seen, hits["geometry_ids"].numpy().astype(np.int64), 0)]
    return np.where(seen, depth, np.nan).astype(np.float32), np.where(seen, labels, 0).astype(np.uint16)
