"""The training set of the `tabletop` preset: what a depth image says of space, kind by kind, with labels.

Knows which samples there are and which label each gets; knows nothing of the fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mapping.threads import map_in_threads
from perception.observation import Observation
from perception.space import Space
from reconstruction.config import TabletopSamples
from reconstruction.samples import labels
from reconstruction.samples.bodies import Body
from reconstruction.samples.draws import SteadyDraws
from reconstruction.samples.even_noise import spread_evenly
from reconstruction.samples.hinge_points import hinge_points
from reconstruction.samples.obstacles import near_obstacles, obstacle_samples
from reconstruction.samples.open_space import OpenSpace, below_support, feet, open_space
from reconstruction.samples.reach_down import FOOT_GAP, visible_end
from reconstruction.samples.scope import Scope
from reconstruction.samples.structure import structure
from reconstruction.samples.surfaces import SurfaceSamples, surface_samples
from reconstruction.samples.training_set import TrainingSet, assemble

GUESSED_DOUBT = 0.3
"""The chance that a surface that was guessed is not there."""

COLUMN = 0.3
"""Hidden samples this likely of an object that is guessed to reach far down, or beyond the image, get hinge
points of their own."""
UPWARDS = np.array([1, 1, -1], np.float32)
"""Mirrors points at the support plane."""

Labelled = tuple[np.ndarray, np.ndarray]
"""Samples (N, 3) with label distributions (N, C+1)."""


def draw_tabletop(
    config: TabletopSamples,
    observation: Observation,
    space: Space,
    rng: np.random.Generator,
    bodies: Sequence[Body | None] = (),
) -> TrainingSet:
    """The training set of one observation, in its table frame.

    Classes: 0 empty, k the k-th object, then obstacles without a label if any are near, the last "uncertain".
    bodies: of the objects whose whole shape is known from what is seen.
    """
    drawn = [_Drawn.of(scope) for scope in Scope.all_of(observation, space, config, rng)]
    obstacles = near_obstacles(observation, config.radius)
    asked = [part.asked for part in drawn]
    guess, filled = structure(observation, space, config, np.concatenate(asked), obstacles, bodies)
    count = guess.shape[1]
    soft: list[Labelled] = []
    fine, thin = [part.scope.seen_nodes(config.fine_spacing) for part in drawn], []
    ends = np.cumsum([len(points) for points in asked])[:-1]
    for part, of_part, full in zip(drawn, np.split(guess, ends), np.split(filled, ends)):
        labelled, walls, columns = part.labelled(of_part, full)
        soft += labelled
        thin.append(walls)
        fine.append(columns)
    if len(obstacles):
        fine.append(obstacles)
        for points, own, doubt in obstacle_samples(obstacles, _origin(space, obstacles)):
            classes, unsure = np.full(len(points), own * (count - 1)), np.full(len(points), doubt)
            soft.append((points, labels.pair(config.labels, classes, unsure, count)))
    seen = [part.scope.seen_nodes(config.finest_spacing) for part in drawn]
    ground = np.concatenate(seen + [part.foot for part in drawn])
    covered = np.concatenate([p for part in drawn for p in (part.around.free, part.around.hidden)])
    hinges, gamma = hinge_points(config, np.concatenate(fine), ground, np.concatenate(thin), covered)
    empty = np.concatenate([p for part in drawn for p in (part.around.empty, part.below)])
    points, targets = map(np.concatenate, zip(*soft))
    return assemble([empty], points, targets, hinges, gamma)


def _origin(space: Space, points: np.ndarray) -> np.ndarray:
    """Where the rays that saw points (N, 3) start: (3,) or (N, 3) [m]."""
    return space.origin_of(space.pixel_of(points))


@dataclass(frozen=True)
class _Drawn:
    """The samples (N, 3) around the objects of one scope."""

    scope: Scope
    around: OpenSpace
    below: np.ndarray
    foot: np.ndarray
    surface: SurfaceSamples

    @classmethod
    def of(cls, scope: Scope) -> _Drawn:
        def under(scope: Scope) -> tuple[np.ndarray, np.ndarray]:
            if scope.supported:
                return below_support(scope), feet(scope)
            below, foot = np.empty((2, 0, 3), np.float32)
            return below, foot

        kinds: tuple[Callable[[Scope], Any], ...] = open_space, under, surface_samples
        # What a generator draws depends on what it drew before.
        if isinstance(scope.draws, SteadyDraws):
            around, (below, foot), surface = map_in_threads(lambda kind: kind(scope), kinds)
        else:
            around, (below, foot), surface = (kind(scope) for kind in kinds)
        return cls(scope, around, below, foot, surface)

    @property
    def asked(self) -> np.ndarray:
        """Places (N, 3) whose class has to be guessed; those of the foot are mirrored at the support."""
        asked = np.concatenate([self.surface.inside, self.surface.wall, self._over_foot, self.around.hidden])
        if self.scope.supported:
            # What lies under the support is empty to the prior; a pair at an object's foot may reach there.
            asked[:, 2] = np.maximum(asked[:, 2], np.float32(self.scope.floor))
        return asked

    @property
    def _over_foot(self) -> np.ndarray:
        """Samples under feet (N, 3) mirrored at the support: right over it."""
        over = self.foot * UPWARDS
        over[:, 2] += np.float32(2 * self.scope.floor)
        return over

    def labelled(
        self, guess: np.ndarray, filled: np.ndarray
    ) -> tuple[list[Labelled], np.ndarray, np.ndarray]:
        """All samples with labels, from the guess (N, K+1) at the places asked, and which of these (N,) lie
        in what is filled; samples (M, 3) in thin walls; and hidden ones (L, 3) of objects that are guessed to
        reach far down."""
        config, surface = self.scope.config, self.surface
        sizes = [len(surface.inside), len(surface.wall), len(self.foot)]
        at_inside, at_wall, at_foot, at_hidden = np.split(guess, np.cumsum(sizes))
        rows, count = np.arange(len(surface.owner)), guess.shape[1]
        fill = np.where(surface.passed, 0, at_wall[rows, surface.owner])
        # The thin shell is a rule of thumb: nothing it says of hidden space is beyond doubt.
        rules, hidden = config.labels, self.around.hidden
        sure = rules.least_uncertain if config.prior == "learned" else rules.most_uncertain / 2
        guessed, likely = self._guessed(hidden, at_hidden, sure, filled[len(guess) - len(hidden) :])
        columns = hidden[likely]
        if config.noise != "occluded":
            scope = self.scope
            near, box = config.noise == "near", (scope.low, scope.high)
            hidden, guessed = spread_evenly(scope.observation, hidden, guessed, *box, near, scope.rng)
        unsure = GUESSED_DOUBT * surface.guessed
        doubt = np.maximum(1 - at_inside[rows, surface.owner], unsure)
        soft = [
            (surface.inside, labels.pair(config.labels, surface.owner, doubt, count)),
            (self.foot, labels.foot(config.labels, at_foot)),
            (hidden, guessed),
        ]
        if config.pairs:
            soft.append((surface.before, labels.pair(config.labels, surface.owner * 0, unsure, count)))
            walls, within = surface.wall, ~surface.passed
            known = filled[len(surface.inside) :][: len(walls)][within]
            owner = surface.owner[within]
            soft.append((walls[within], labels.wall(rules, owner, 1 - fill[within], count, known)))
            empty = np.zeros(len(walls) - within.sum(), int)
            soft.append((walls[surface.passed], labels.pair(rules, empty, 0 * empty, count)))
        # Nothing is seen of a foot that hangs in the air: the empty samples under it need a match.
        over, standing = self._guessed(self._over_foot, at_foot, sure, filled[sum(sizes[:2]) : sum(sizes)])
        soft.append((self._over_foot[standing], over[standing]))
        thin = surface.inside[(fill < config.thin) | surface.flat]
        return soft, thin, columns

    def _guessed(
        self, points: np.ndarray, guess: np.ndarray, sure: float, filled: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Labels of hidden samples (N, 3) by their guess (N, K+1), and by whether they lie in what is filled
        (N,); and which (N,) are likely of an object whose visible part ends high above its support and them,
        or outside the image."""
        outside = self.scope.space.pixel_of(points) < 0
        found = labels.hidden(self.scope.config.labels, guess, sure, filled)
        found[outside] = labels.outside(self.scope.config.labels, guess[outside])
        likely = outside & (guess[:, 1:].max(1, initial=0) > COLUMN)
        for item, own in zip(self.scope.items, self.scope.classes):
            end = visible_end(item, self.scope.space)
            if self.scope.supported and end - item.floor > FOOT_GAP:
                likely |= (guess[:, own] > COLUMN) & (points[:, 2] < end)
        return found, likely
