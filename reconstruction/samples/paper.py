"""Samples and hinge points as the paper and V-PRISM draw them, for the `paper` preset and the baselines."""

from __future__ import annotations

import numpy as np

from mapping.hinges import lattice_near_centres, random_subset
from mapping.samples import along_rays, jittered_lattice, voxel_subsample, within
from perception.camera import transform
from perception.observation import Observation
from perception.space import Space
from perception.views.joint_space import each_view
from reconstruction.config import PaperSamples
from reconstruction.samples.training_set import TrainingSet, assemble


def draw_paper(
    config: PaperSamples, observation: Observation, space: Space, rng: np.random.Generator
) -> TrainingSet:
    """The training set of one observation, in its table frame."""
    centres = np.array([np.mean(o.bounds, axis=0) for o in observation.objects], np.float32)
    parts = []
    for seen, own in each_view(observation, space):
        free = along_rays(own.origin, _surface_points(seen), config.ray_step, 0.0, rng)
        parts.append(free[within(free, centres, config.radius)])
    if observation.support is not None:
        low, high = centres.min(0) - config.radius, centres.max(0) + config.radius
        below = jittered_lattice(low, np.array([*high[:2], 0.0]), config.empty_voxel, rng)
        parts.append(below[(below[:, 2] < 0) & within(below, centres, config.radius)])
    empty = np.concatenate(parts)
    empty = empty[voxel_subsample(empty, config.empty_voxel, rng)]
    classes = [empty]
    hinges = [lattice_near_centres(centres, config.hinge_radius, config.hinge_spacing)]
    for item in observation.objects:
        classes.append(item.points[voxel_subsample(item.points, config.surface_voxel, rng)])
        hinges.append(random_subset(item.points, config.surface_hinges, rng))
    count = int(np.ceil(config.noise_ratio * sum(map(len, classes))))
    all_hinges = np.concatenate(hinges).astype(np.float32)
    noise = _noise_near(centres, config.radius, count, observation.support is not None, rng)
    uncertain = np.tile(np.eye(len(classes) + 1)[-1], (count, 1))
    gamma = np.full(len(all_hinges), config.gamma)
    return assemble(classes, noise, uncertain, all_hinges, gamma)


def _surface_points(observation: Observation) -> np.ndarray:
    """(N, 3) every measured point of the frame in the table frame."""
    points = observation.camera.back_project(observation.depth)[np.isfinite(observation.depth)]
    return transform(observation.T_table_camera, points)


def _noise_near(
    centres: np.ndarray, radius: float, count: int, above_plane: bool, rng: np.random.Generator
) -> np.ndarray:
    """`count` points evenly in balls around the centres, above the support plane if there is one."""
    kept: list[np.ndarray] = []
    low, high = centres.min(0) - radius, centres.max(0) + radius
    if above_plane:
        low[2] = max(low[2], 0.0)
    while sum(map(len, kept)) < count:
        points = rng.uniform(low, high, (4 * count, 3)).astype(np.float32)
        kept.append(points[within(points, centres, radius)])
    return np.concatenate(kept)[:count]
