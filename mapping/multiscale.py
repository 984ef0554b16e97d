"""A contrastive map of many points with kernels of several widths, hinge points only where points are.

Knows points in R^d, classes and settings; must not know scans, meshes, files' layouts or what a class means.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mapping.baselines.hilbert import HilbertMap
from mapping.config import FitConfig, ModelConfig
from mapping.contramap import ContraMap
from mapping.errors import ConfigError, DataError
from mapping.kernels import cell_numbers
from mapping.label_noise import disagreement, wrong_label_share
from mapping.samples import merge_in_cells
from mapping.settings import Checked, NotNegative, Positive, Share


@dataclass(frozen=True)
class MultiscaleConfig(Checked):
    """Kernels, penalty and noise of a map of many points."""

    SECTION = "semantic"

    spacings: tuple[float, ...] = (0.2, 0.6, 2.0)
    """Distance of hinge points at each scale [m]."""
    amplitudes: tuple[float, ...] = (0.3, 0.6, 1.0)
    """How readily each scale explains the data; small ones leave more to the wide kernels."""
    width: Positive = 1.5
    """gamma times the squared spacing."""
    stretch: tuple[float, ...] = (1.0, 1.0, 3.0)
    """Axes are stretched by this before kernels see them: things lie in layers, so a kernel is flat."""
    l2: Positive = 1e-6
    """Penalty of the weights where no label is wrong; it grows with the share of wrong labels found."""
    wrong_label_share: Share = 0.02
    """Share of wrong labels at which the penalty is twice as large."""
    mend_from: Share = 0.08
    """With more wrong labels than this the map is fitted again without those it disbelieves."""
    class_balance: Share = 0.5
    """Samples weigh as their class's count to the minus this: 0 as counted, 1 every class alike."""
    merge: NotNegative = 0.3
    """Data of one class in a cell of this share of the finest spacing become one weighted sample."""
    noise_share: NotNegative = 0.1
    """Noise samples, and their whole weight, as a share of the data's."""
    noise_reach: Positive = 1.0
    """Noise is drawn within this many of the widest spacings of the hinge points."""
    doubt: Share = 0.2
    """Share of a sample's disagreement with its neighbours that becomes "uncertain" instead of its class."""
    fit: FitConfig = field(default_factory=lambda: FitConfig(tolerance=2e-4))
    """How the loss is minimised."""


@dataclass(frozen=True)
class Whole:
    """What a part of the data must know of the whole. counts: (C,) points of each class; wrong: share of
    labels that are wrong."""

    counts: np.ndarray
    wrong: float

    def weights(self, balance: float) -> np.ndarray:
        """(C,) weight of a sample of each class, one on average."""
        rare = 1.0 / np.maximum(self.counts, 1) ** balance
        return rare * (self.counts.sum() / (rare * self.counts).sum())


@dataclass(frozen=True)
class Hinges:
    """points: (H, d) in stretched coordinates; gamma, amplitude: (H,)."""

    points: np.ndarray
    gamma: np.ndarray
    amplitude: np.ndarray


class MultiscaleMap:
    """Softmax over kernels of several widths; classes 0..C-1, and "uncertain" last unless `uncertain=False`.

    Without the uncertain class it is a Hilbert map of the same kernels.
    """

    def __init__(self, config: MultiscaleConfig | None = None, uncertain: bool = True) -> None:
        self.config = config or MultiscaleConfig()
        self.uncertain = uncertain
        self.model: ContraMap | None = None
        if not len(self.config.spacings) == len(self.config.amplitudes) > 0:
            raise ConfigError("spacings and amplitudes must be as many numbers, one of each a scale")

    def fit(
        self,
        X: np.ndarray,
        y: np.ndarray,
        classes: int,
        rng: np.random.Generator,
        whole: Whole | None = None,
    ) -> MultiscaleMap:
        """Learn from points X (N, d) with labels y (N,) in 0..classes-1; rng draws the noise samples.

        whole: of the data that these points are a part of, so that parts fitted alone agree at their seams.
        """
        config = self.config
        X, y = self._stretched(X), np.asarray(y, np.int64)
        if len(y) != len(X) or not len(X):
            raise DataError(f"wanted as many labels as points, and at least one; got {len(y)}, {len(X)}")
        if whole is None:
            whole = Whole(np.bincount(y, minlength=classes), wrong_label_share(X, y, config.spacings[:2]))
        weights = whole.weights(config.class_balance)[y]
        wrong, total = whole.wrong, int(whole.counts.sum())
        X, y, weights = merge_in_cells(X, y, weights, config.merge * config.spacings[0])
        X = X.astype(np.float32)
        # The penalty stands beside a mean: a part with fewer samples needs a larger one for the same map.
        share = total / weights.sum()
        self._fit_samples(X, y, weights, classes, share * self._penalty(wrong), rng)
        if wrong > config.mend_from:
            kept = self._believed(X, y, wrong, classes)
            X, y, weights = X[kept], y[kept], weights[kept]
            left = 2 * config.wrong_label_share  # some wrong labels stay among the believed ones
            self._fit_samples(X, y, weights, classes, share * self._penalty(left), rng)
        return self

    def _penalty(self, wrong: float) -> float:
        return self.config.l2 * (1 + (wrong / self.config.wrong_label_share) ** 2)

    def _believed(self, X: np.ndarray, y: np.ndarray, wrong: float, classes: int) -> np.ndarray:
        """(N,) whether a label is likelier right than wrong, given what the map of all labels says there and
        that a share `wrong` of them was drawn from all classes alike."""
        if self.uncertain:
            right = self.fitted.predict_known(X)[0][np.arange(len(X)), y]
        else:
            right = self.fitted.predict_proba(X)[np.arange(len(X)), y]
        return (1 - wrong) * right > wrong / classes

    def _fit_samples(
        self,
        X: np.ndarray,
        y: np.ndarray,
        weights: np.ndarray,
        classes: int,
        l2: float,
        rng: np.random.Generator,
    ) -> None:
        """Fit to samples X (N, d) in stretched coordinates with labels y (N,) and weights (N,)."""
        config, hinges = self.config, hinges_near(X, self.config)
        settings = ModelConfig(l2=l2, fit=config.fit)
        if not self.uncertain:
            self.model = HilbertMap(settings)
            self._run(X, y, weights, hinges, classes)
            return
        noise = noise_around(hinges, config, int(config.noise_share * len(X)), rng)
        doubt = config.doubt * disagreement(X, y, config.spacings[min(1, len(config.spacings) - 1)])
        target = np.zeros((len(X) + len(noise), classes + 1), np.float32)
        target[np.arange(len(X)), y] = 1 - doubt
        target[: len(X), classes] = doubt
        target[len(X) :, classes] = 1
        weights = np.append(weights, np.full(len(noise), weights.mean()))
        self.model = ContraMap(settings)
        self._run(np.concatenate([X, noise]), target, weights, hinges, classes + 1)

    def _run(self, X: np.ndarray, y: np.ndarray, weights: np.ndarray, hinges: Hinges, classes: int) -> None:
        self.fitted.fit(
            X,
            y,
            hinges=hinges.points,
            gamma=hinges.gamma,
            weights=weights,
            classes=classes,
            amplitude=hinges.amplitude,
        )

    @property
    def fitted(self) -> ContraMap:
        """The map inside, in stretched coordinates."""
        if self.model is None:
            raise DataError("this map is not fitted yet; call fit(X, y, classes, rng)")
        return self.model

    def predict_known(self, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Probabilities (N, C) of the classes but "uncertain" at points (N, d), and p(uncertain) (N,)."""
        if self.uncertain:
            return self.fitted.predict_known(self._stretched(X))
        shares = self.fitted.predict_proba(self._stretched(X))
        return shares, 1 - shares.max(axis=1)

    def predict_proba(self, X: np.ndarray) -> np.ndarray:
        """Class probabilities (N, C + 1) at points (N, d), the uncertain class last."""
        return self.fitted.predict_proba(self._stretched(X))

    def predict_lattice(self, axes: tuple[np.ndarray, ...]) -> np.ndarray:
        """Class probabilities (*lattice, C + 1) on the lattice that d coordinate arrays span."""
        stretched = (axis * factor for axis, factor in zip(axes, self.config.stretch))
        return self.fitted.predict_lattice(tuple(stretched))

    def save(self, path: Path) -> None:
        """Write the map (in stretched coordinates) as one .npz file."""
        self.fitted.save(path)

    def load(self, path: Path) -> MultiscaleMap:
        """Take up a map that `save` wrote with the same settings."""
        from mapping.model_io import load_map

        self.model = load_map(path)
        return self

    def _stretched(self, X: np.ndarray) -> np.ndarray:
        X = np.asarray(X)
        if X.ndim != 2 or X.shape[1] != len(self.config.stretch):
            raise DataError(f"points must have shape (N, {len(self.config.stretch)}), got {X.shape}")
        return (X * np.asarray(self.config.stretch)).astype(np.float32)


def in_plane(config: MultiscaleConfig) -> MultiscaleConfig:
    """The same settings for points in the plane, where no axis is stretched."""
    return replace(config, stretch=(1.0, 1.0))


def hinges_near(X: np.ndarray, config: MultiscaleConfig) -> Hinges:
    """Lattice points whose cells hold points (N, d), for every scale."""
    points, gamma, amplitude = [], [], []
    for spacing, loudness in zip(config.spacings, config.amplitudes):
        found = filled_cells(X, spacing) * np.float32(spacing)
        points.append(found.astype(np.float32))
        gamma.append(np.full(len(found), config.width / spacing**2, np.float32))
        amplitude.append(np.full(len(found), loudness, np.float32))
    return Hinges(*(np.concatenate(parts) for parts in (points, gamma, amplitude)))


def filled_cells(X: np.ndarray, size: float) -> np.ndarray:
    """Numbers (M, d) int64 of the cells, centred on multiples of `size`, that hold points (N, d)."""
    cell = np.rint(X / size).astype(np.int64)
    _, first = np.unique(cell_numbers(cell - cell.min(0)), return_index=True)
    return cell[first]


def noise_around(
    hinges: Hinges, config: MultiscaleConfig, count: int, rng: np.random.Generator
) -> np.ndarray:
    """Points (count, d), spread over the cells around the hinge points of the widest scale."""
    spacing = max(config.spacings)
    widest = hinges.points[hinges.gamma == hinges.gamma.min()]
    reach = int(np.ceil(config.noise_reach))
    steps = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * widest.shape[1]), -1)
    around = widest[:, None] + spacing * steps.reshape(-1, widest.shape[1])
    cells = filled_cells(around.reshape(-1, widest.shape[1]), spacing)
    chosen = cells[rng.integers(0, len(cells), count)]
    return ((chosen + rng.uniform(-0.5, 0.5, chosen.shape)) * spacing).astype(np.float32)
