"""Samples and hinge points that use what a depth image says of space, for the `tabletop` preset.

Knows what one observation says of free, occluded and supporting space; knows nothing of the fit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from mapping.hinges import lattice_near_points
from mapping.samples import jittered, jittered_lattice, shift_along_rays, voxel_subsample
from perception.observation import Observation
from perception.space import Region, Space
from reconstruction.even_noise import spread_evenly
from reconstruction.hidden_space import hidden_labels
from reconstruction.training_set import TrainingSet, assemble


@dataclass(frozen=True)
class TabletopSamples:
    """Samples that use what the depth image says of space: surface pairs, free and occluded samples."""

    radius: float = 0.16
    """The map covers this distance around each object's box [m]."""
    coarse_spacing: float = 0.05
    """Spacing of the hinge lattice over the whole covered space [m]."""
    coarse_gamma: float = 1000.0
    """Kernel width of the coarse hinge points [1/m^2]."""
    fine_spacing: float = 0.025
    """Spacing of the hinge lattice near objects and behind their surface [m]."""
    fine_gamma: float = 2000.0
    """Kernel width of the fine hinge points [1/m^2]."""
    fine_distance: float = 0.03
    """Fine hinge points lie within this distance of a seen object surface [m]."""
    finest_spacing: float = 0.0125
    """Spacing of the hinge lattice on seen object surfaces [m]."""
    finest_gamma: float = 8000.0
    """Kernel width of the finest hinge points [1/m^2]."""
    finest_distance: float = 0.0
    """Finest hinge points lie within this distance of a seen object surface [m]; negative: none."""
    surface_voxel: float = 0.008
    """Voxel that keeps one surface pair of an object [m]."""
    pair_offset: float = 0.0025
    """A free sample this far before, an object sample this far behind each surface point [m]."""
    near_spacing: float = 0.010
    """Spacing of samples of every kind near seen object surfaces [m]."""
    near_distance: float = 0.02
    """How far from a seen object surface is near [m]."""
    free_spacing: float = 0.03
    """Spacing of free samples elsewhere [m]."""
    occluded_spacing: float = 0.012
    """Spacing of samples in occluded space elsewhere [m]."""
    unknown_distance: float = 0.06
    """Samples where nothing was measured lie within this distance of an object's box [m]."""
    floor_spacing: float = 0.013
    """Spacing of empty samples right under the support plane [m]."""
    below_spacing: float = 0.03
    """Spacing of empty samples deeper under the support plane [m]."""
    below_depth: float = 0.04
    """Thickness of the layer under the support plane that is known to be empty of objects [m]."""
    least_uncertain: float = 0.06
    """Share of "uncertain" in the label of an occluded sample whose structure is beyond doubt."""
    most_uncertain: float = 0.95
    """Share of "uncertain" in the label of a sample of which nothing is known."""
    pair_uncertain: float = 0.02
    """Share of "uncertain" in the labels of a surface pair that nothing speaks against."""
    wall: float = 0.014
    """Hidden space nearer than this behind an object's seen surface is not sampled [m]: the surface pairs say
    what is there. With such samples, thin walls came out as lace."""
    most_pair_uncertain: float = 0.8
    """Share of "uncertain" in the label of a sample behind a seen surface that the prior takes for empty: a
    thin wall. More ranks errors better and tears more holes into walls."""
    prior: Literal["learned", "none"] = "learned"
    """What guesses the structure of occluded space: the learned occlusion prior, or a thin shell."""
    shell: float = 0.02
    """Without a prior, occluded space nearer than this to a seen surface leans to that object [m]."""

    pairs: bool = True
    """False, for ablations: one sample on each surface point instead of a pair around it."""
    noise: Literal["occluded", "near", "everywhere"] = "occluded"
    """Where "uncertain" is learned: in occluded space or, for ablations, evenly near objects or all over."""

    def draw(self, observation: Observation, space: Space, rng: np.random.Generator) -> TrainingSet:
        """The training set of one observation, in its table frame."""
        seen = np.concatenate([item.points for item in observation.objects])
        low, high = seen.min(0) - self.radius, seen.max(0) + self.radius
        supported = observation.support is not None
        if supported:
            low[2] = 0.0
        free = self._cover(observation, low, high, self.free_spacing, rng)
        free = free[space.classify(free) == Region.FREE]
        hidden = self._cover(observation, low, high, self.occluded_spacing, rng)
        region = space.classify(hidden)
        # Where nothing was measured beside an object, the kernels would let it grow unchecked.
        unknown = (region == Region.OUT_OF_VIEW) & observation.near_objects(hidden, self.unknown_distance)
        hidden = hidden[(region == Region.OCCLUDED) | unknown]
        near = lattice_near_points(seen, self.near_distance, self.near_spacing)
        near = jittered(near, self.near_spacing, rng)
        region = space.classify(near)
        hidden = np.concatenate([hidden, near[(region == Region.OCCLUDED) | (region == Region.OUT_OF_VIEW)]])
        hidden = hidden[~self._within_wall(observation, space, hidden)]
        empty = [free, near[(region == Region.FREE) | (region == Region.BELOW_SUPPORT)]]
        before, inside = [], []
        for item in observation.objects:
            points = item.points[voxel_subsample(item.points, self.surface_voxel, rng)]
            if self.pairs:
                before.append(shift_along_rays(space.origin, points, -self.pair_offset))
            inside.append(shift_along_rays(space.origin, points, self.pair_offset if self.pairs else 0))
        if supported:
            # A dense layer right under the plane closes the objects' bottoms, a coarse one goes deeper.
            for top, bottom, spacing in (
                (0.0, -self.pair_offset, self.floor_spacing),
                (-self.pair_offset, -self.below_depth, self.below_spacing),
            ):
                layer = np.array([*low[:2], bottom]), np.array([*high[:2], top])
                below = self._cover(observation, *layer, spacing, rng)
                empty.append(below[below[:, 2] < top])
        behind = np.concatenate([*inside, hidden])
        structure = self._structure(observation, space, behind)
        owner = np.repeat(np.arange(len(inside)), [len(points) for points in inside]) + 1
        count = len(owner) if self.pairs else 0
        labels = [
            self._pair_labels(owner[:count] * 0, np.zeros(count), structure.shape[1]),
            self._pair_labels(owner, 1 - structure[np.arange(len(owner)), owner], structure.shape[1]),
            self._hidden_labels(structure[len(owner) :]),
        ]
        hinges, gamma = self._hinges(seen, np.concatenate([free, hidden]))
        if self.noise != "occluded":
            near_objects = self.noise == "near"
            hidden, labels[2] = spread_evenly(observation, hidden, labels[2], low, high, near_objects, rng)
        soft = np.concatenate([*before, *inside, hidden])
        return assemble([np.concatenate(empty)], soft, np.concatenate(labels), hinges, gamma)

    def _hinges(self, seen: np.ndarray, covered: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Hinge points (H, 3) and widths (H,): coarse over the covered space, finer near what is seen."""
        lattices = [
            (lattice_near_points(covered, 0.0, self.coarse_spacing), self.coarse_gamma),
            (lattice_near_points(seen, self.fine_distance, self.fine_spacing), self.fine_gamma),
        ]
        if self.finest_distance >= 0:
            finest = lattice_near_points(seen, self.finest_distance, self.finest_spacing)
            lattices.append((finest, self.finest_gamma))
        points, widths = zip(*lattices)
        return np.concatenate(points), np.repeat(widths, [len(p) for p in points])

    def _cover(
        self,
        observation: Observation,
        low: np.ndarray,
        high: np.ndarray,
        spacing: float,
        rng: np.random.Generator,
    ) -> np.ndarray:
        """Jittered samples (M, 3) of the box low..high that lie within `radius` of any object's box."""
        points = jittered_lattice(low, high, spacing, rng)
        return points[observation.near_objects(points, self.radius)]

    def _within_wall(self, observation: Observation, space: Space, points: np.ndarray) -> np.ndarray:
        """Which points (N, 3) lie so little behind an object's seen surface that they belong to its wall."""
        owned = np.zeros(observation.depth.size, bool)
        for item in observation.objects:
            owned[item.pixels] = True
        pixel = space.pixel_of(points)
        return (pixel >= 0) & owned[pixel] & (space.depth_behind(points) < self.wall)

    def _structure(self, observation: Observation, space: Space, points: np.ndarray) -> np.ndarray:
        """(N, K+1) guess of {empty, object 1..K} at points (N, 3) behind what is seen."""
        if self.prior == "learned" and observation.support is not None:
            # What lies under the plane is empty to the prior; a pair at an object's foot may reach below it.
            above = np.column_stack([points[:, :2], np.maximum(points[:, 2], 0)])
            return hidden_labels(observation, space, above)
        return self._shell_structure(observation, points)

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

    def _hidden_labels(self, structure: np.ndarray) -> np.ndarray:
        """Labels (N, K+2) of occluded samples with class distributions (N, K+1): what is there, as far as
        it is sure.

        p(uncertain) is to rank errors, so its share rises linearly with the chance that the likeliest class
        is wrong, from `least_uncertain` to `most_uncertain` at even odds.
        """
        doubt = np.minimum(2 * (1 - structure.max(1)), 1)
        # The thin shell is a rule of thumb: nothing it says of hidden space is beyond doubt.
        least = self.least_uncertain if self.prior == "learned" else self.most_uncertain / 2
        doubt = least + (self.most_uncertain - least) * doubt
        return np.column_stack([structure * (1 - doubt)[:, None], doubt])

    def _pair_labels(self, classes: np.ndarray, doubt: np.ndarray, count: int) -> np.ndarray:
        """Labels (N, K+2) of one side of surface pairs: the class (N,) seen there, and doubt (N,), the chance
        that it is another.

        Doubt, as behind the thin wall of a cup, goes to "uncertain" and to no other class: the surface was
        seen, and keeps its place.
        """
        labels = np.zeros((len(classes), count + 1), np.float32)
        labels[:, -1] = self.pair_uncertain + (self.most_pair_uncertain - self.pair_uncertain) * doubt
        labels[np.arange(len(classes)), classes] = 1 - labels[:, -1]
        return labels
