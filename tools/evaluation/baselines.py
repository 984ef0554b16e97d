"""The kernel maps ContraMap is compared with, as methods of the evaluation.

Knows how each is fitted on a view and what its uncertainty is; knows nothing of truth or metrics.
"""

from __future__ import annotations

import numpy as np

from mapping.baselines.base import gini
from mapping.baselines.bayesian_hilbert import BayesianHilbertConfig
from mapping.baselines.hilbert import HilbertMap
from mapping.baselines.one_vs_rest import OneVsRestHilbertMap
from mapping.baselines.vprism import VPrism, VPrismConfig, normalised_entropy
from mapping.baselines.vprism_dense import DenseVPrism
from reconstruction.config import PaperSamples, preset
from reconstruction.samples.paper import draw_paper
from tools.evaluation.fitted_map import FittedMap, View, beside, nodes


class FittedHilbert(FittedMap):
    """Hilbert map on the paper's features and samples without noise; uncertainty is its answer's entropy."""

    def __init__(self, view: View, rng: np.random.Generator) -> None:
        self.samples, y, hinges = observed_samples(view, rng)
        self.classes = len(view.observation.objects) + 1
        self.model = HilbertMap(preset("paper", "cpu").map)
        self.model.fit(self.samples, y, hinges=hinges, gamma=PaperSamples().gamma, classes=self.classes)
        self.lattice = self.model.lattice()

    def predict(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        probability = self.model.predict_proba(points)
        return probability, normalised_entropy(probability)

    def occupancy(self, axes: list[np.ndarray], index: int) -> np.ndarray:
        return self.lattice.share(axes, index + 1, self.classes)

    def worth_asking(self, axes: list[np.ndarray]) -> np.ndarray:
        return beside(self.lattice.largest(axes) > 0)


class FittedVPrism(FittedMap):
    """V-PRISM on its own hinge points and samples: uncertainty is the entropy of the averaged softmax."""

    def __init__(self, view: View, rng: np.random.Generator, model: VPrism) -> None:
        self.samples, y, hinges = observed_samples(view, rng)
        self.model = model.fit(self.samples, y, hinges, rng, classes=len(view.observation.objects) + 1)
        self.means = model.mean_lattice()

    @classmethod
    def published(cls, view: View, rng: np.random.Generator) -> FittedVPrism:
        """As its code has it, features below rounding dropped."""
        return cls(view, rng, VPrism())

    @classmethod
    def with_bound(cls, view: View, rng: np.random.Generator) -> FittedVPrism:
        """Alpha as the bound has it."""
        return cls(view, rng, VPrism(VPrismConfig(alpha="bound")))

    def predict(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        probability = self.model.predict_proba(points)
        return probability, normalised_entropy(probability)

    def worth_asking(self, axes: list[np.ndarray]) -> np.ndarray:
        # P_k = 1 / (1 + sum_j exp(-margin_kj)) > 1/2 needs every margin > 0: only the class with the largest
        # mean can have it. Means are cheap on a lattice, variances are not.
        return beside(self.means.largest(axes) > 0)


class FittedDenseVPrism(FittedVPrism):
    """V-PRISM with every feature kept, asked at every node of the coarse grid, as its code does."""

    def __init__(self, view: View, rng: np.random.Generator) -> None:
        super().__init__(view, rng, DenseVPrism())

    def occupancy(self, axes: list[np.ndarray], index: int) -> np.ndarray:
        return self.predict(nodes(axes))[0][:, index + 1].reshape([len(axis) for axis in axes])


class FittedOneVsRest(FittedMap):
    """One Bayesian Hilbert map an object and one for empty space, on V-PRISM's hinge points and samples,
    normalised over them."""

    def __init__(self, view: View, rng: np.random.Generator) -> None:
        self.samples, y, hinges = observed_samples(view, rng)
        config = BayesianHilbertConfig(gamma=PaperSamples().gamma)
        classes = len(view.observation.objects) + 1
        self.model = OneVsRestHilbertMap(config).fit(self.samples, y, hinges, rng, classes=classes)
        self.means = self.model.mean_lattice()

    def predict(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        alone = self.model.predict_proba(points)
        probability = alone / np.maximum(alone.sum(1, keepdims=True), 1e-9)
        return probability, gini(probability)

    def worth_asking(self, axes: list[np.ndarray]) -> np.ndarray:
        # An object's share passes 1/2 only where it beats empty space. That cannot be where its own mean is
        # negative and that of empty space positive, whatever the variances are.
        means = self.means(axes).numpy()
        return beside((means[1:] > 0).any(0) | (means[0] < 0))


def observed_samples(view: View, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """V-PRISM's samples X (N, 3), classes y (N,) and hinge points (H, 3): the paper's without its noise."""
    training = draw_paper(PaperSamples(), view.observation, view.space, rng)
    y = training.y.argmax(1)
    observed = y < training.y.shape[1] - 1
    return training.X[observed], y[observed], training.hinges
