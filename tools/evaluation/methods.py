"""Every method behind one interface: fit on an observation, answer anywhere in the table frame.

Knows observations and maps; knows nothing of truth or metrics. Class 0 is empty space, class k the k-th
observed object; probabilities are among these, whatever a method does with its uncertain class.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import torch
from scipy import ndimage

from mapping.baselines.base import gini
from mapping.baselines.bayesian_hilbert import BayesianHilbertConfig
from mapping.baselines.hilbert import HilbertMap
from mapping.baselines.one_vs_rest import OneVsRestHilbertMap
from mapping.baselines.vprism import VPrism, VPrismConfig, normalised_entropy
from mapping.baselines.vprism_dense import DenseVPrism
from mapping.contramap import ContraMap
from mapping.errors import ConfigError
from mapping.lattice import LatticeEvaluator
from perception.observation import Observation
from perception.space import Space
from reconstruction.config import override, preset
from reconstruction.samples.paper import PaperSamples
from reconstruction.samples.training_set import TrainingSet
from reconstruction.scene import object_floor
from reconstruction.surface.field import OUTSIDE, Field, evaluate_field, window_of
from reconstruction.surface.meshing import MeshConfig
from tools.options import nested_setting


class FittedMap(ABC):
    """What a method learned from one observation.

    samples: (N, 3) the observed points it learned from [m]; keeps_seen: whether its meshes keep every cell
    with a seen point (MeshConfig.keep_seen).
    """

    samples: np.ndarray
    keeps_seen = False

    @abstractmethod
    def predict(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Probabilities (N, K+1) of empty and the K objects, and uncertainty (N,), at points (N, 3)."""

    def occupancy(self, axes: list[np.ndarray], index: int) -> np.ndarray:
        """P(object `index`), 0-based, on the lattice spanned by three coordinate arrays: (nx, ny, nz).

        0 at nodes that are not worth asking.
        """
        wanted = self.worth_asking(axes)
        out = np.zeros(wanted.shape, np.float32)
        out[wanted] = self.predict(_nodes(axes)[wanted.reshape(-1)])[0][:, index + 1]
        return out

    def field(self, lows: np.ndarray, highs: np.ndarray, spacing: float) -> Field:
        """Log odds and uncertainty on a lattice of `spacing` [m] over boxes lows..highs (K, 3)."""
        low, high = lows.min(0), highs.max(0)
        origin = np.floor(low / spacing) * spacing
        axes = [o + spacing * np.arange(int(np.ceil((h - o) / spacing)) + 2) for o, h in zip(origin, high)]
        nodes = _nodes(axes)
        wanted = self.worth_asking(axes).reshape(-1)
        probability, uncertainty = self.predict(nodes[wanted])
        shape = tuple(len(axis) for axis in axes)
        odds = np.full((probability.shape[1] - 1, len(nodes)), OUTSIDE, np.float32)
        p = np.clip(probability[:, 1:].T, 1e-6, 1 - 1e-6)
        odds[:, wanted] = np.log(p / (1 - p))
        everywhere = np.ones(len(nodes), np.float32)
        everywhere[wanted] = uncertainty
        windows = [window_of(origin, spacing, shape, *box) for box in zip(lows, highs)]
        of_objects = [of_one.reshape(shape)[window] for of_one, window in zip(odds, windows)]
        return Field(origin, spacing, windows, of_objects, everywhere.reshape(shape))

    def worth_asking(self, axes: list[np.ndarray]) -> np.ndarray:
        """Lattice nodes (nx, ny, nz) where an object can have P > 0.5, and those beside them."""
        return np.ones([len(axis) for axis in axes], bool)


class FittedContraMap(FittedMap):
    """ContraMap: uncertainty is the probability of its uncertain class.

    mesh: how the preset takes meshes; floor: no object is below it [m].
    """

    def __init__(
        self, model: ContraMap, training: TrainingSet, mesh: MeshConfig, floor: float | None = None
    ) -> None:
        self.model, self.mesh, self.floor, self.keeps_seen = model, mesh, floor, mesh.keep_seen
        self.lattice = model.lattice()
        self.samples = training.X[training.y.argmax(1) < training.y.shape[1] - 1]

    def predict(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        logits = self.model.logits(points)
        structure = torch.softmax(logits[:, :-1], 1)
        return structure.cpu().numpy(), torch.softmax(logits, 1)[:, -1].cpu().numpy()

    def occupancy(self, axes: list[np.ndarray], index: int) -> np.ndarray:
        logits = self.lattice(axes)[:-1]
        probability = torch.softmax(logits, 0)[index + 1].cpu().numpy()
        if self.floor is not None:
            probability[:, :, axes[2] < self.floor] = 0
        return probability

    def field(self, lows: np.ndarray, highs: np.ndarray, spacing: float) -> Field:
        return evaluate_field(self.model, lows, highs, spacing, self.floor, self.mesh.confined)


class FittedHilbert(FittedMap):
    """Hilbert map: the same softmax, uncertainty is the entropy of its answer."""

    def __init__(self, model: HilbertMap, samples: np.ndarray) -> None:
        self.model, self.samples, self.lattice = model, samples, model.lattice()

    def predict(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        probability = self.model.predict_proba(points)
        return probability, normalised_entropy(probability)

    def occupancy(self, axes: list[np.ndarray], index: int) -> np.ndarray:
        return torch.softmax(self.lattice(axes), 0)[index + 1].cpu().numpy()

    def worth_asking(self, axes: list[np.ndarray]) -> np.ndarray:
        return _beside(self.lattice(axes).argmax(0).cpu().numpy() > 0)


class FittedVPrism(FittedMap):
    """V-PRISM: uncertainty is the entropy of the averaged softmax."""

    def __init__(self, model: VPrism, samples: np.ndarray) -> None:
        self.model, self.samples = model, samples
        weights, hinges = model.mu.T.float(), model.hinges
        bias = weights[-1] if model.config.bias else torch.zeros(model.class_count)
        gamma = np.full(len(hinges), model.config.gamma, np.float32)
        self.means = LatticeEvaluator(hinges, gamma, weights[: len(hinges)], bias)

    def predict(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        probability = self.model.predict_proba(points)
        return probability, normalised_entropy(probability)

    def worth_asking(self, axes: list[np.ndarray]) -> np.ndarray:
        # P_k = 1 / (1 + sum_j exp(-margin_kj)) > 1/2 needs every margin > 0: only the class with the largest
        # mean can have it. Means are cheap on a lattice, variances are not.
        return _beside(self.means(axes).argmax(0).numpy() > 0)


class FittedDenseVPrism(FittedVPrism):
    """V-PRISM with every feature kept, asked at every node of the coarse grid, as its code does."""

    def occupancy(self, axes: list[np.ndarray], index: int) -> np.ndarray:
        return self.predict(_nodes(axes))[0][:, index + 1].reshape([len(axis) for axis in axes])


class FittedOneVsRest(FittedMap):
    """One Bayesian Hilbert map an object and one for empty space, normalised over them."""

    def __init__(self, model: OneVsRestHilbertMap, samples: np.ndarray) -> None:
        self.model, self.samples = model, samples

    def predict(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        alone = self.model.predict_proba(points)
        probability = alone / np.maximum(alone.sum(1, keepdims=True), 1e-9)
        return probability, gini(probability)

    def worth_asking(self, axes: list[np.ndarray]) -> np.ndarray:
        # An object's share passes 1/2 only where it beats empty space. That cannot be where its own mean is
        # negative and that of empty space positive, whatever the variances are.
        hinges = self.model.hinges
        gamma = np.full(len(hinges), self.model.config.gamma, np.float32)
        weights = torch.from_numpy(self.model.mu.T.astype(np.float32))
        means = LatticeEvaluator(hinges, gamma, weights, torch.zeros(len(self.model.mu)))(axes).numpy()
        return _beside((means[1:] > 0).any(0) | (means[0] < 0))


Method = Callable[[Observation, Space, np.random.Generator], FittedMap]


def fit_contramap(
    name: str,
    observation: Observation,
    space: Space,
    rng: np.random.Generator,
    settings: Sequence[str] = (),
) -> FittedMap:
    """ContraMap as the preset `name` has it, but for some settings `section.field=value`."""
    config = preset(name, "cpu")
    for setting in settings:
        config = override(config, nested_setting(setting))
    training = config.samples.draw(observation, space, rng)
    model = ContraMap(config.map).fit(training.X, training.y, hinges=training.hinges, gamma=training.gamma)
    return FittedContraMap(model, training, config.mesh, object_floor(observation, config))


def fit_hilbert(observation: Observation, space: Space, rng: np.random.Generator) -> FittedMap:
    """The paper's features and samples without noise and without an uncertain class."""
    X, y, hinges = observed_samples(observation, space, rng)
    config = preset("paper", "cpu")
    model = HilbertMap(config.map)
    model.fit(X, y, hinges=hinges, gamma=PaperSamples().gamma, classes=len(observation.objects) + 1)
    return FittedHilbert(model, X)


def fit_vprism(
    observation: Observation,
    space: Space,
    rng: np.random.Generator,
    config: VPrismConfig | None = None,
) -> FittedMap:
    """V-PRISM on its own hinge points and samples."""
    X, y, hinges = observed_samples(observation, space, rng)
    model = VPrism(config).fit(X, y, hinges, rng, classes=len(observation.objects) + 1)
    return FittedVPrism(model, X)


def fit_dense_vprism(observation: Observation, space: Space, rng: np.random.Generator) -> FittedMap:
    """V-PRISM as published, on its own hinge points and samples."""
    X, y, hinges = observed_samples(observation, space, rng)
    model = DenseVPrism().fit(X, y, hinges, rng, classes=len(observation.objects) + 1)
    return FittedDenseVPrism(model, X)


def fit_bayesian_hilbert(observation: Observation, space: Space, rng: np.random.Generator) -> FittedMap:
    """Binary Bayesian Hilbert maps, one class against the rest, on V-PRISM's hinge points and samples."""
    X, y, hinges = observed_samples(observation, space, rng)
    config = BayesianHilbertConfig(gamma=PaperSamples().gamma)
    model = OneVsRestHilbertMap(config).fit(X, y, hinges, rng, classes=len(observation.objects) + 1)
    return FittedOneVsRest(model, X)


def fit_tsdf(observation: Observation, space: Space, rng: np.random.Generator) -> FittedMap:
    """A truncated signed distance field of each object's masked depth (Open3D)."""
    from tools.evaluation.tsdf import FittedTsdf

    return FittedTsdf(observation)


METHODS: dict[str, Method] = {
    "vprism": fit_vprism,
    "vprism-dense": fit_dense_vprism,
    "vprism-bound": partial(fit_vprism, config=VPrismConfig(alpha="bound")),
    "contramap": partial(fit_contramap, "tabletop"),
    "contramap-paper": partial(fit_contramap, "paper"),
    "hilbert": fit_hilbert,
    "bayesian-hilbert": fit_bayesian_hilbert,
    "tsdf": fit_tsdf,
}


SEEDLESS = frozenset({"tsdf"})
"""Methods whose fit draws nothing: one fit serves all seeds, which only draw the points of the metrics."""


def method(name: str) -> Method:
    """A method by name, or ContraMap with other settings: `contramap:prior=none,map.l2=1e-5` (a name without
    a dot is a field of TabletopSamples). ConfigError lists the valid ones."""
    base, _, text = name.partition(":")
    if text and base == "contramap":
        parts = text.split(",")
        settings = [part if "." in part.partition("=")[0] else f"samples.{part}" for part in parts]
        return partial(fit_contramap, "tabletop", settings=settings)
    if name not in METHODS:
        raise ConfigError(f"unknown method {name!r}; valid methods: {', '.join(METHODS)}")
    return METHODS[name]


def observed_samples(
    observation: Observation, space: Space, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """V-PRISM's samples X (N, 3), classes y (N,) and hinge points (H, 3): the paper's without its noise."""
    samples = preset("paper").samples
    training = samples.draw(observation, space, rng)
    y = training.y.argmax(1)
    observed = y < training.y.shape[1] - 1
    return training.X[observed], y[observed], training.hinges


def _nodes(axes: list[np.ndarray]) -> np.ndarray:
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3).astype(np.float32)


def _beside(inside: np.ndarray) -> np.ndarray:
    """Nodes that are inside or neighbours of those: marching cubes looks no further."""
    return ndimage.binary_dilation(inside, np.ones((3, 3, 3), bool))
