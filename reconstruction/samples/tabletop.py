"""The training set of the `tabletop` preset: what a depth image says of space, kind by kind, with labels.

Knows which samples there are and which label each gets; knows nothing of the fit.
"""

from __future__ import annotations

import numpy as np

from perception.observation import Observation
from perception.space import Space
from reconstruction.config import TabletopSamples
from reconstruction.samples import labels
from reconstruction.samples.even_noise import spread_evenly
from reconstruction.samples.hinge_points import hinge_points
from reconstruction.samples.open_space import below_support, feet, open_space
from reconstruction.samples.scope import Scope
from reconstruction.samples.structure import structure
from reconstruction.samples.surfaces import surface_samples
from reconstruction.samples.training_set import TrainingSet, assemble

UPWARDS = np.array([1, 1, -1], np.float32)
"""Mirrors points at the support plane."""


def draw_tabletop(
    config: TabletopSamples, observation: Observation, space: Space, rng: np.random.Generator
) -> TrainingSet:
    """The training set of one observation, in its table frame."""
    scope = Scope.of(observation, space, config, rng)
    around = open_space(scope)
    below, foot = np.empty((2, 0, 3), np.float32)
    if scope.supported:
        below, foot = below_support(scope), feet(scope)
    surface = surface_samples(scope)
    asked = [surface.inside, surface.wall, foot * UPWARDS, around.hidden]
    guess = structure(scope, np.concatenate(asked))
    at_inside, at_wall, at_foot, at_hidden = np.split(guess, np.cumsum([len(part) for part in asked[:-1]]))
    rows, count = np.arange(len(surface.owner)), guess.shape[1]
    fill = at_wall[rows, surface.owner]
    thin = surface.inside[(fill < config.thin) | surface.flat]
    covered = np.concatenate([around.free, around.hidden])
    hinges, gamma = hinge_points(config, scope.seen, foot, thin, covered)
    # The thin shell is a rule of thumb: nothing it says of hidden space is beyond doubt.
    least = None if config.prior == "learned" else config.labels.most_uncertain / 2
    hidden, guessed = around.hidden, labels.hidden(config.labels, at_hidden, least)
    if config.noise != "occluded":
        near = config.noise == "near"
        hidden, guessed = spread_evenly(observation, hidden, guessed, scope.low, scope.high, near, rng)
    doubt = 1 - at_inside[rows, surface.owner]
    soft = [
        (surface.inside, labels.pair(config.labels, surface.owner, doubt, count)),
        (foot, labels.foot(config.labels, at_foot)),
        (hidden, guessed),
    ]
    if config.pairs:
        free = labels.pair(config.labels, surface.owner * 0, np.zeros(len(surface.owner)), count)
        soft.append((surface.before, free))
        soft.append((surface.wall, labels.wall(config.labels, surface.owner, 1 - fill, count)))
    points, targets = map(np.concatenate, zip(*soft))
    return assemble([np.concatenate([around.empty, below])], points, targets, hinges, gamma)
