"""What a map of one view more starts from: the weights of the earlier map of the same scene, where it had the
same hinge points, and the surfaces that stay.

Knows maps and training sets in one table frame; knows nothing of images.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import trimesh

from mapping.config import ModelConfig
from mapping.contramap import ContraMap
from mapping.known_points import among
from mapping.lifted import Lifted
from perception.observation import NOTHING, OTHER
from perception.views.joint import JointObservation
from reconstruction.result import ObjectField, ReconstructedObject
from reconstruction.samples.training_set import TrainingSet
from reconstruction.surface.whole_shape import WholeShape

SHAPES = "shapes"
"""Entry of an observation's memo, with the settings they were looked for by: shapes by label."""
LEFT = "left"
"""Entry of an observation's memo: what views leave of the uncertainty of surfaces that stayed, by label."""

LIFTED = "lifted"
"""Entry of an observation's memo: the samples' features."""


@dataclass(frozen=True)
class Surface:
    """One object's closed surface in the table frame. uncertainty: (V,) float32 p(uncertain) at vertices;
    field: the map it was taken from, where that is an earlier one, and placed: the same as it was delivered
    then."""

    mesh: trimesh.Trimesh
    uncertainty: np.ndarray
    field: ObjectField | None = None
    placed: ReconstructedObject | None = None


@dataclass(frozen=True)
class Before:
    """A map that was fitted before. labels: of its columns, as Reconstruction.map_labels. surfaces: of its
    objects, by label; kept: those of them that stay as they are, no view being new to them; shapes: that
    they were found to have, as far as they were looked for; left: (V,) what the earlier views leave of the
    uncertainty at a surface's vertices, by label, as far as that was worked out; lifted: its samples, where
    they are kept."""

    map: ContraMap
    labels: tuple[int, ...]
    surfaces: Mapping[int, Surface] = field(default_factory=dict)
    kept: frozenset[int] = frozenset()
    shapes: Mapping[int, WholeShape | None] = field(default_factory=dict)
    left: Mapping[int, np.ndarray] = field(default_factory=dict)
    lifted: Lifted | None = None

    def weights(self, training: TrainingSet, labels: Sequence[int]) -> np.ndarray:
        """(H, C+1) float32: the earlier weights of each hinge point and class; 0 for new ones. Hinge points
        of one width are the same to the bit: they lie on lattices of one origin.

        labels: of the objects, in the order of their classes.
        """
        count = training.y.shape[1]
        own = [0, *labels, *[OTHER] * (count - 2 - len(labels)), NOTHING]
        columns = [(k, self.labels.index(label)) for k, label in enumerate(own) if label in self.labels]
        new, old = map(list, zip(*columns))
        earlier = self.map.W.cpu().numpy()
        start = np.zeros((len(training.hinges), count), np.float32)
        for gamma in np.unique(training.gamma):
            here, there = np.flatnonzero(training.gamma == gamma), np.flatnonzero(self.map.gamma == gamma)
            where = among(training.hinges[here], self.map.hinges[there])
            same = where >= 0
            start[np.ix_(here[same], new)] = earlier[np.ix_(there[where[same]], old)]
        return start


def fit_of_views(
    config: ModelConfig, training: TrainingSet, observation: JointObservation, before: Before | None
) -> ContraMap:
    """The map of several views' samples, from an earlier one where there is any. The samples' features are
    kept with the observation: the next view leaves most of them as they are."""
    model, lifted, start = ContraMap(config), None, None
    if model.device.type == "cpu":
        earlier = None if before is None else before.lifted
        lifted = Lifted.of(training.X, training.hinges, training.gamma, config.fit_cutoff, earlier)
        observation.memo[LIFTED] = lifted
    if before is not None:
        start = before.weights(training, [item.label for item in observation.objects])
    return model.fit(
        training.X, training.y, hinges=training.hinges, gamma=training.gamma, start=start, lifted=lifted
    )
