"""Samples and hinge points that use what a depth image says of space, for the `tabletop` preset.

Knows what one observation says of free, occluded and supporting space; knows nothing of the fit.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from mapping.hinges import lattice_near_points
from mapping.samples import jittered, jittered_lattice, shift_along_rays, voxel_subsample
from perception.observation import Observation
from perception.space import Region, Space
from reconstruction.prior.evidence import hidden_labels
from reconstruction.samples.even_noise import spread_evenly
from reconstruction.samples.labels import TabletopLabels
from reconstruction.samples.training_set import TrainingSet, assemble

FOOT_CLEARANCE = 0.0015
"""Samples keep this distance from the support plane, which is known no better [m]."""
UPWARDS = np.array([1, 1, -1], np.float32)
"""Mirrors points at the support plane."""
LEVEL = np.array([1, 1, 0], np.float32)
"""Drops points on the support plane."""
DEEPER_SHARE = 0.3
"""As many more samples, as a share of those right under a foot, lie deeper."""
DEEPER = (0.005, 0.020)
"""How deep under the support plane [m]."""


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
    fine_gamma: float = 3000.0
    """Kernel width of the fine hinge points [1/m^2]."""
    fine_distance: float = 0.03
    """Fine hinge points lie within this distance of a seen object surface [m]."""
    finest_spacing: float = 0.0125
    """Spacing of the hinge lattice on seen object surfaces [m]."""
    finest_gamma: float = 8000.0
    """Kernel width of the finest hinge points [1/m^2]."""
    finest_distance: float = 0.0
    """Finest hinge points lie within this distance of a seen object surface [m]; negative: none."""
    thin_spacing: float = 0.00625
    """Spacing of the hinge lattice on thin walls and thin things [m]; 0: none."""
    thin_gamma: float = 32000.0
    """Kernel width of the hinge points there [1/m^2]."""
    thin: float = 0.5
    """A wall is thin where the chance that it reaches down to `wall_depth` is below this, or where the
    support plane comes first."""
    surface_voxel: float = 0.007
    """Voxel that keeps one surface pair of an object [m]."""
    pair_offset: float = 0.0025
    """A free sample this far before each surface point [m]."""
    pair_depth: float = 0.0015
    """An object sample this far behind it [m]; less than before it, for walls are thin."""
    wall_depth: float = 0.007
    """A third sample this far behind it [m]: is there more than a thin wall?"""
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
    foot_spacing: float = 0.008
    """Spacing of empty samples right under what may be an object's hidden foot [m]."""
    foot_distance: float = 0.02
    """A foot lies within this distance of the box of what is seen of its object [m]."""
    below_spacing: float = 0.03
    """Spacing of empty samples deeper under the support plane [m]."""
    below_depth: float = 0.04
    """Thickness of the layer under the support plane that is known to be empty of objects [m]."""
    wall: float = 0.014
    """Hidden space nearer than this behind an object's seen surface is not sampled [m]: surface pairs and
    wall samples say what is there. With such samples, thin walls came out as lace."""
    prior: Literal["learned", "none"] = "learned"
    """What guesses the structure of occluded space: the learned occlusion prior, or a thin shell."""
    labels: TabletopLabels = field(default_factory=TabletopLabels)
    """How sure the labels are."""
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
        free, hidden, empty = self._space_samples(observation, space, seen, low, high, rng)
        below, foot = np.empty((2, 0, 3), np.float32)
        if supported:
            below = self._below(observation, low, high, rng)
            foot = self._feet(observation, space, low, high, rng)
        before, inside, wall, owner = self._surface_samples(observation, space, rng)
        flat = np.zeros(len(wall), bool)
        if supported:
            # Nothing reaches into the table; what lies flat on it is filled down to it.
            flat = wall[:, 2] < FOOT_CLEARANCE
            inside[:, 2] = np.maximum(inside[:, 2], FOOT_CLEARANCE)
            drop = inside[flat] - wall[flat]
            wall[flat] = inside[flat] - drop * ((inside[flat, 2:] - FOOT_CLEARANCE) / drop[:, 2:])
        asked = np.concatenate([inside, wall, foot * UPWARDS, hidden])
        structure = self._structure(observation, space, asked)
        ends = np.cumsum([len(inside), len(wall), len(foot)])
        at_inside, at_wall, at_foot, at_hidden = np.split(structure, ends)
        rows, count = np.arange(len(owner)), structure.shape[1]
        fill = at_wall[rows, owner]
        thin = (fill < self.thin) | flat
        hinges, gamma = self._hinges(seen, foot, inside[thin], np.concatenate([free, hidden]))
        # The thin shell is a rule of thumb: nothing it says of hidden space is beyond doubt.
        least = None if self.prior == "learned" else self.labels.most_uncertain / 2
        guessed = self.labels.hidden(at_hidden, least)
        if self.noise != "occluded":
            near = self.noise == "near"
            hidden, guessed = spread_evenly(observation, hidden, guessed, low, high, near, rng)
        soft = [
            (inside, self.labels.pair(owner, 1 - at_inside[rows, owner], count)),
            (foot, self.labels.foot(at_foot)),
            (hidden, guessed),
        ]
        if self.pairs:
            soft.append((before, self.labels.pair(owner * 0, np.zeros(len(owner)), count)))
            soft.append((wall, self.labels.wall(owner, 1 - fill, count)))
        points, labels = map(np.concatenate, zip(*soft))
        return assemble([np.concatenate([empty, below])], points, labels, hinges, gamma)

    def _space_samples(
        self,
        observation: Observation,
        space: Space,
        seen: np.ndarray,
        low: np.ndarray,
        high: np.ndarray,
        rng: np.random.Generator,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Samples of free space away from objects, of hidden space, and all that are known to be empty."""
        free = self._cover(observation, low, high, self.free_spacing, rng)
        free = free[space.classify(free) == Region.FREE]
        hidden = self._cover(observation, low, high, self.occluded_spacing, rng)
        region = space.classify(hidden)
        # Where nothing was measured beside an object, the kernels would let it grow unchecked.
        unknown = region == Region.OUT_OF_VIEW
        unknown[unknown] = observation.near_objects(hidden[unknown], self.unknown_distance)
        hidden = hidden[(region == Region.OCCLUDED) | unknown]
        near = lattice_near_points(seen, self.near_distance, self.near_spacing)
        near = jittered(near, self.near_spacing, rng)
        region = space.classify(near)
        hidden = np.concatenate([hidden, near[(region == Region.OCCLUDED) | (region == Region.OUT_OF_VIEW)]])
        hidden = hidden[~self._within_wall(observation, space, hidden)]
        empty = near[(region == Region.FREE) | (region == Region.BELOW_SUPPORT)]
        return free, hidden, np.concatenate([free, empty])

    def _surface_samples(
        self, observation: Observation, space: Space, rng: np.random.Generator
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Samples (N, 3) before seen surfaces, right behind them and in their walls; class (N,) of each."""
        points = [
            item.points[voxel_subsample(item.points, self.surface_voxel, rng)] for item in observation.objects
        ]
        owner = np.repeat(np.arange(len(points)), [len(of_one) for of_one in points]) + 1
        surface = np.concatenate(points)
        offsets = (-self.pair_offset, self.pair_depth if self.pairs else 0.0, self.wall_depth)
        before, inside, wall = (shift_along_rays(space.origin, surface, offset) for offset in offsets)
        return before, inside, wall, owner

    def _below(
        self, observation: Observation, low: np.ndarray, high: np.ndarray, rng: np.random.Generator
    ) -> np.ndarray:
        """Samples (M, 3) under the support plane: a dense layer right under it, a coarse one deeper."""
        layers = []
        for top, bottom, spacing in (
            (0.0, -self.pair_offset, self.floor_spacing),
            (-self.pair_offset, -self.below_depth, self.below_spacing),
        ):
            layer = np.array([*low[:2], bottom]), np.array([*high[:2], top])
            points = self._cover(observation, *layer, spacing, rng)
            layers.append(points[points[:, 2] < top])
        return np.concatenate(layers)

    def _feet(
        self,
        observation: Observation,
        space: Space,
        low: np.ndarray,
        high: np.ndarray,
        rng: np.random.Generator,
    ) -> np.ndarray:
        """Samples (M, 3) under the support plane where an object may stand unseen, most of them right under
        it: they close the objects' bottoms."""
        points = jittered_lattice(low * LEVEL, high * LEVEL, self.foot_spacing, rng)
        points = points[observation.near_objects(points, self.foot_distance)]
        points[:, 2] = FOOT_CLEARANCE
        points = points[space.classify(points) != Region.FREE]
        deeper = points[rng.random(len(points)) < DEEPER_SHARE]
        points[:, 2] = -FOOT_CLEARANCE
        deeper[:, 2] = -rng.uniform(*DEEPER, len(deeper))
        return np.concatenate([points, deeper])

    def _hinges(
        self, seen: np.ndarray, foot: np.ndarray, thin: np.ndarray, covered: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Hinge points (H, 3) and widths (H,): coarse over the covered space, finer near what is seen, finest
        on thin walls."""
        lattices = [
            (lattice_near_points(covered, 0.0, self.coarse_spacing), self.coarse_gamma),
            (lattice_near_points(seen, self.fine_distance, self.fine_spacing), self.fine_gamma),
        ]
        if self.finest_distance >= 0:
            ground = np.concatenate([seen, foot])
            finest = lattice_near_points(ground, self.finest_distance, self.finest_spacing)
            lattices.append((finest, self.finest_gamma))
        if self.thin_spacing > 0 and len(thin):
            on_walls = lattice_near_points(thin, 0.0, self.thin_spacing)
            lattices.append((on_walls, self.thin_gamma))
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
        sight = space.look(points)
        return (sight.pixel >= 0) & owned[sight.pixel] & (sight.behind < self.wall)

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
