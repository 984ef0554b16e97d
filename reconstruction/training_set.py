"""From one observation to the map's training set: hinge points and samples of every class.

Knows what a tabletop frame says of space; knows nothing of how the map is fitted or used.
Class 0 is empty space, class k the k-th observed object, the last class "uncertain".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from mapping.hinges import lattice_near_centres, lattice_near_points, random_subset
from mapping.samples import along_rays, jittered_lattice, shift_along_rays, voxel_subsample, within
from perception.camera import transform
from perception.observation import Observation
from perception.space import Region, Space


@dataclass(frozen=True)
class TrainingSet:
    """Samples and hinge points in the table frame.

    X: (N, 3) float32 [m]; y: (N, C+1) float32 label distributions, one-hot where the class is known;
    hinges: (H, 3) float32 [m]; gamma: (H,) float32 [1/m^2].
    """

    X: np.ndarray
    y: np.ndarray
    hinges: np.ndarray
    gamma: np.ndarray


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
        return _assemble(classes, noise, uncertain, all_hinges, gamma)


@dataclass(frozen=True)
class TabletopSamples:
    """Samples that use what the depth image says of space: surface pairs, free and occluded voxels."""

    radius: float = 0.18
    """The map covers this distance around each object's box [m]."""
    coarse_spacing: float = 0.05
    """Spacing of the hinge lattice over the whole covered space [m]."""
    coarse_gamma: float = 500.0
    """Kernel width of the coarse hinge points [1/m^2]."""
    fine_spacing: float = 0.025
    """Spacing of the hinge lattice near objects and behind them [m]."""
    fine_gamma: float = 2000.0
    """Kernel width of the fine hinge points [1/m^2]."""
    fine_distance: float = 0.03
    """Fine hinge points lie within this distance of a seen object surface [m]."""
    surface_voxel: float = 0.008
    """Voxel that keeps one surface pair of an object [m]."""
    pair_offset: float = 0.005
    """A free sample this far before, an object sample this far behind each surface point [m]."""
    free_spacing: float = 0.025
    """Spacing of free samples [m]."""
    occluded_spacing: float = 0.018
    """Spacing of noise samples in occluded space [m]."""
    below_spacing: float = 0.02
    """Spacing of empty samples under the support plane [m]."""
    below_depth: float = 0.04
    """Thickness of the layer under the support plane that is known to be empty of objects [m]."""
    least_uncertain: float = 0.4
    """Share of "uncertain" in the label of an occluded sample whose structure is beyond doubt."""
    shell: float = 0.02
    """Without a prior, occluded space nearer than this to an object's seen surface leans to that object [m]."""

    def draw(self, observation: Observation, space: Space, rng: np.random.Generator) -> TrainingSet:
        lows, highs = (np.array(b) for b in zip(*(o.bounds for o in observation.objects)))
        low, high = lows.min(0) - self.radius, highs.max(0) + self.radius
        supported = observation.support is not None
        floor = 0.0 if supported else low[2]
        free = self._voxels(low, high, floor, self.free_spacing, lows, highs, rng)
        free = free[space.classify(free) == Region.FREE]
        hidden = self._voxels(low, high, floor, self.occluded_spacing, lows, highs, rng)
        hidden = hidden[space.classify(hidden) == Region.OCCLUDED]
        empty, inside = [free], []
        for item in observation.objects:
            points = item.points[voxel_subsample(item.points, self.surface_voxel, rng)]
            empty.append(shift_along_rays(space.origin, points, -self.pair_offset))
            inside.append(shift_along_rays(space.origin, points, self.pair_offset))
        if supported:
            below = self._voxels(low, high, -self.below_depth, self.below_spacing, lows, highs, rng)
            footprint = self._voxels(low, high, -self.pair_offset, self.below_spacing / 2, lows, highs, rng)
            empty.extend([below[below[:, 2] < -self.pair_offset], footprint[footprint[:, 2] < 0]])
        classes = [np.concatenate(empty), *inside]
        structure = self._shell_structure(observation, hidden)
        coarse = lattice_near_points(np.concatenate([free, hidden]), 0.0, self.coarse_spacing)
        seen = np.concatenate([o.points for o in observation.objects])
        fine = lattice_near_points(seen, self.fine_distance, self.fine_spacing)
        gamma = np.repeat([self.coarse_gamma, self.fine_gamma], [len(coarse), len(fine)])
        return _assemble(
            classes, hidden, self._soft_labels(structure), np.concatenate([coarse, fine]), gamma
        )

    def _shell_structure(self, observation: Observation, points: np.ndarray) -> np.ndarray:
        """(N, K+1) guess of {empty, object 1..K} from the distance to each object's seen surface alone."""
        distance = np.stack([cKDTree(o.points[::4]).query(points)[0] for o in observation.objects], 1)
        nearest = distance.argmin(1)
        rows = np.arange(len(points))
        inside = 1 / (1 + np.exp((distance[rows, nearest] - self.shell) / (0.3 * self.shell)))
        structure = np.zeros((len(points), len(observation.objects) + 1), np.float32)
        structure[rows, nearest + 1] = inside
        structure[:, 0] = 1 - inside
        return structure

    def _soft_labels(self, structure: np.ndarray) -> np.ndarray:
        """Labels (N, C+1) of occluded samples: sure structure keeps its label, doubt becomes "uncertain"."""
        entropy = -(structure * np.log(np.maximum(structure, 1e-9))).sum(1) / np.log(2)
        doubt = self.least_uncertain + (1 - self.least_uncertain) * np.minimum(entropy, 0.97)
        return np.column_stack([structure * (1 - doubt)[:, None], doubt])

    def _voxels(self, low, high, floor, spacing, lows, highs, rng) -> np.ndarray:
        """Jittered samples above `floor` within `radius` of any object's box."""
        points = jittered_lattice(np.array([*low[:2], floor]), high, spacing, rng)
        near = np.zeros(len(points), bool)
        for box_low, box_high in zip(lows, highs):
            gap = np.maximum(np.maximum(box_low - points, points - box_high), 0)
            near |= (gap**2).sum(1) < self.radius**2
        return points[near]


def _surface_points(observation: Observation) -> np.ndarray:
    """(N, 3) every measured point of the frame in the table frame."""
    points = observation.camera.back_project(observation.depth)[np.isfinite(observation.depth)]
    return transform(observation.T_table_camera, points)


def _noise_near(
    centres: np.ndarray, radius: float, count: int, above_plane: bool, rng: np.random.Generator
) -> np.ndarray:
    """`count` points evenly in the union of balls around the centres, above the support plane if there is one."""
    kept: list[np.ndarray] = []
    low, high = centres.min(0) - radius, centres.max(0) + radius
    if above_plane:
        low[2] = max(low[2], 0.0)
    while sum(map(len, kept)) < count:
        points = rng.uniform(low, high, (4 * count, 3)).astype(np.float32)
        kept.append(points[within(points, centres, radius)])
    return np.concatenate(kept)[:count]


def _assemble(
    classes: list[np.ndarray],
    soft: np.ndarray,
    soft_labels: np.ndarray,
    hinges: np.ndarray,
    gamma: np.ndarray,
) -> TrainingSet:
    """One set from samples of each class (hard labels) and samples with label distributions."""
    hard = np.repeat(np.arange(len(classes)), [len(c) for c in classes])
    X = np.concatenate([*classes, soft]).astype(np.float32)
    y = np.zeros((len(X), soft_labels.shape[1]), np.float32)
    y[np.arange(len(hard)), hard] = 1
    y[len(hard) :] = soft_labels
    return TrainingSet(X, y, hinges, gamma.astype(np.float32))
