"""Samples and hinge points as the paper and V-PRISM draw them, for the `paper` preset and the baselines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapping.hinges import lattice_near_centres, random_subset
from mapping.samples import along_rays, jittered_lattice, voxel_subsample, within
from perception.camera import transform
from perception.observation import Observation
from perception.space import Space
from reconstruction.samples.training_set import TrainingSet, assemble


@dataclass(frozen=True)
class PaperSamples:
    """Hinge points and samples as V-PRISM and the paper draw them (paper, Section V-D)."""

    hinge_spacing: float = 0.05
    """Spacing of the hinge lattice near objects [m]."""
    hinge_radius: float = 0.15
    """Hinge points lie within this distance of an object's box centre [m]."""
    surface_hinges: int = 32
    """Random surface points an object used as further hinge points."""
    gamma: float = 1000.0
    """Kernel width [1/m^2]."""
    ray_step: float = 0.10
    """One free sample in each step of every ray [m]."""
    radius: float = 0.25
    """Samples lie within this distance of an object's box centre [m]."""
    empty_voxel: float = 0.015
    """Voxel that keeps one empty sample [m]."""
    surface_voxel: float = 0.01
    """Voxel that keeps one surface sample of an object [m]."""
    noise_ratio: float = 0.025
    """Noise samples as a share of the other samples, drawn evenly near objects."""

    def draw(self, observation: Observation, space: Space, rng: np.random.Generator) -> TrainingSet:
        centres = np.array([np.mean(o.bounds, axis=0) for o in observation.objects], np.float32)
        surface = _surface_points(observation)
        free = along_rays(space.origin, surface, self.ray_step, 0.0, rng)
        parts = [free[within(free, centres, self.radius)]]
        if observation.support is not None:
            low, high = centres.min(0) - self.radius, centres.max(0) + self.radius
            below = jittered_lattice(low, np.array([*high[:2], 0.0]), self.empty_voxel, rng)
            parts.append(below[(below[:, 2] < 0) & within(below, centres, self.radius)])
        empty = np.concatenate(parts)
        empty = empty[voxel_subsample(empty, self.empty_voxel, rng)]
        classes = [empty]
        hinges = [lattice_near_centres(centres, self.hinge_radius, self.hinge_spacing)]
        for item in observation.objects:
            classes.append(item.points[voxel_subsample(item.points, self.surface_voxel, rng)])
            hinges.append(random_subset(item.points, self.surface_hinges, rng))
        count = int(np.ceil(self.noise_ratio * sum(map(len, classes))))
        all_hinges = np.concatenate(hinges).astype(np.float32)
        noise = _noise_near(centres, self.radius, count, observation.support is not None, rng)
        uncertain = np.tile(np.eye(len(classes) + 1)[-1], (count, 1))
        gamma = np.full(len(all_hinges), self.gamma)
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
