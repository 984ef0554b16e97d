"""A contrastive map of many points with kernels of several shapes, hinge points only where points are.

Knows points in space, classes and settings; must not know scans, meshes, files' layouts or what a class
means.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mapping.cell_noise import MOST_EACH, cells_around, lie_in, noise_in
from mapping.checks import checked_points
from mapping.config import FitConfig
from mapping.errors import ConfigError, DataError
from mapping.freed_memory import give_back
from mapping.hashed_hinges import HashedHinges, cube_by_cube, filled_nodes, hinges_at
from mapping.hashed_tiles import shares_at
from mapping.label_doubt import Labels, label_doubt
from mapping.label_noise import disagreement, true_labels, wrong_label_share
from mapping.lattice_factor import LatticeFactor
from mapping.samples import merge_in_cells
from mapping.settings import Checked, CountOrNone, NotNegative, OpenShare, Positive, Share
from mapping.softmax import FitReport
from mapping.weighed_features import WeighedFeatures, fit_classes, fit_last_class

ROWS = 2**18
"""Places whose answers need not be kept side by side are asked for so many at a time."""

BALL, POST, TRUNK, FLOOR, ROOM = (
    (0.1, 0.1, 0.1),
    (0.3, 0.3, 3.0),
    (1.0, 1.0, 5.0),
    (2.0, 2.0, 0.67),
    (3.0,) * 3,
)
PLANK_ALONG, PLANK_ACROSS = (2.5, 0.5, 0.25), (0.5, 2.5, 0.25)


@dataclass(frozen=True)
class MultiscaleConfig(Checked):
    """Kernels, penalty and noise of a map of many points."""

    SECTION = "semantic"

    spacings: tuple[tuple[float, ...], ...] = (BALL, POST, TRUNK, FLOOR, ROOM, PLANK_ALONG, PLANK_ACROSS)
    """Distance of hinge points along x, y and z (up) [m] for each shape of kernel, which has that shape, too:
    things stand upright, lie in layers, and go on along streets and walls."""
    amplitudes: tuple[float, ...] = (0.3, 0.6, 1.0, 1.0, 1.5, 0.6, 0.6)
    """How readily each shape explains the data; small ones leave more to the wide kernels."""
    width: Positive = 1.5
    """gamma times the squared spacing."""
    cutoff: OpenShare = 1e-2
    """Features below this are dropped."""
    l2: Positive = 1e-6
    """Penalty of the weights where no label is wrong; it grows with the share of wrong labels found."""
    wrong_label_share: Share = 0.055
    """Share of wrong labels at which the penalty is twice as large; it grows with its square."""
    mend_from: Share = 0.08
    """With more wrong labels than this the map is fitted again to what its first fit makes of the labels."""
    mended_penalty: Share = 0.3
    """Penalty of that second fit, as a share of the first one's."""
    label_cells: tuple[float, ...] = (0.2, 0.4)
    """Cells [m] in which labels are compared to tell how many are wrong; the first is tried first."""
    class_balance: Share = 0.5
    """Samples weigh as their class's count to the minus this: 0 as counted, 1 every class alike. Not where
    labels are mended: a rare class's wrong labels would outweigh its right ones."""
    merge: NotNegative = 0.06
    """Data of one class in a cell of this size [m] become one weighted sample."""
    noise_share: NotNegative = 0.1
    """Noise samples, and their whole weight, as a share of the data's."""
    noise_cell: tuple[float, ...] = FLOOR
    """Noise is drawn in cells of this size [m] that hold data, and in those around them."""
    far_cells: tuple[tuple[float, ...], ...] = ((1.0, 1.0, 2.5), ROOM)
    """Beyond those cells wide kernels of data reach places without noise. There one sample is drawn in each
    cell of these sizes [m] that holds data, and in those around it."""
    far_around: tuple[tuple[int, int, int], ...] = ((0, 0, 2), (1, 1, 1))
    """How many cells around it that is along x, y and z, for each of those sizes."""
    doubt: Share = 0.2
    """Share of a sample's disagreement with its neighbours that becomes "uncertain" instead of its class."""
    far_uncertainty: OpenShare = 0.95
    """p(uncertain) out of reach of every hinge point."""
    fit: FitConfig = field(default_factory=lambda: FitConfig(tolerance=4e-4, memory=2, renew=8))
    """How the loss is minimised, unless local_steps says otherwise."""
    local_steps: CountOrNone = 0
    """So many steps that depend on what is near alone: parts fitted alone have the whole's probabilities,
    for about twice the time. 0: quasi-Newton steps, which look at all data."""


@dataclass(frozen=True)
class Whole:
    """What a part of the data must know of the whole. counts: (C,) points of each class; wrong: share of
    labels that are wrong; noise_cells: number of cells that noise is drawn in."""

    counts: np.ndarray
    wrong: float
    noise_cells: int

    @classmethod
    def of(cls, X: np.ndarray, y: np.ndarray, classes: int, config: MultiscaleConfig) -> Whole:
        """Found in points X (N, 3) [m] with labels y (N,)."""
        cells = cells_around(X, np.array(config.noise_cell))
        return cls(np.bincount(y, minlength=classes), wrong_label_share(X, y, config.label_cells), len(cells))

    def weights(self, balance: float) -> np.ndarray:
        """(C,) weight of a sample of each class, one on average."""
        rare = 1.0 / np.maximum(self.counts, 1) ** balance
        return rare * (self.counts.sum() / (rare * self.counts).sum())


class MultiscaleMap:
    """Softmax over kernels of several shapes; classes 0..C-1, and "uncertain" last unless `uncertain=False`.

    A sample's likelihood is that of its class where it was observed, times that of being observed. Noise says
    nothing about the first: the classes' weights are those of a Hilbert map of the data, which is what there
    is without the uncertain class, and the weights of "uncertain" are fitted against them. Fitted all at
    once, noise bends the borders between classes.
    """

    def __init__(self, config: MultiscaleConfig | None = None, uncertain: bool = True) -> None:
        self.config = config or MultiscaleConfig()
        self.uncertain = uncertain
        self.report = FitReport()
        self.hinges: HashedHinges | None = None
        self.W = np.empty((0, 0), np.float32)
        self.known = np.empty(0, np.int64)
        self.classes = 0
        config = self.config
        if not len(config.spacings) == len(config.amplitudes) > 0:
            raise ConfigError("semantic.spacings and .amplitudes must be as many, one of each a shape")
        if len(config.far_cells) != len(config.far_around):
            raise ConfigError("semantic.far_cells and .far_around must be as many, one of each a size")
        lengths = (*config.spacings, *config.far_cells, config.noise_cell)
        if any(len(one) != 3 or min(one) <= 0 for one in lengths):
            raise ConfigError("semantic.spacings and noise cells must be three lengths > 0 each: x, y and z")

    def fit(
        self,
        X: np.ndarray,
        y: np.ndarray,
        classes: int,
        rng: np.random.Generator,
        whole: Whole | None = None,
    ) -> MultiscaleMap:
        """Learn from points X (N, 3) [m] with labels y (N,) in 0..classes-1; rng draws the noise samples.

        whole: of the data that these points are a part of: parts fitted alone, with rng of the same seed,
        have the same noise samples and agree at their seams.
        """
        config = self.config
        X, y = _in_space(X).astype(np.float64), np.asarray(y, np.int64)
        if len(y) != len(X) or not len(X):
            raise DataError(f"wanted as many labels as points, and at least one; got {len(y)}, {len(X)}")
        whole = whole or Whole.of(X, y, classes, config)
        mend = whole.wrong > config.mend_from
        weights = whole.weights(0.0 if mend else config.class_balance)[y]
        if config.merge:
            X, y, weights = merge_in_cells(X, y, weights, config.merge)
        nodes = [cube_by_cube(filled_nodes(X, np.array(spacing))) for spacing in config.spacings]
        spacings, amplitudes = np.array(config.spacings), np.array(config.amplitudes)
        self.hinges = hinges_at(nodes, spacings, amplitudes, config.width, config.cutoff)
        total = int(whole.counts.sum())
        l2 = total * config.l2 * (1 + (whole.wrong / config.wrong_label_share) ** 2)
        # All of the whole's, or what other classes are left would differ from part to part.
        self.classes, self.known = classes, np.flatnonzero(whole.counts)
        y = np.searchsorted(self.known, y)
        data, factor = WeighedFeatures.of(X, weights, self.hinges), LatticeFactor.of(self.hinges)
        labels, offset = np.eye(len(self.known), dtype=np.float32)[y], self._offset()
        given, columns = offset[: len(self.known)], np.arange(len(self.known))
        how = config.fit, config.local_steps
        self.W, self.report = fit_classes(data, labels, given, factor, l2, *how)
        if mend:
            shares = shares_at(X, self.hinges, self.W, given, columns, len(columns))
            labels, l2 = true_labels(y, shares, whole.wrong), config.mended_penalty * l2
            self.W, self.report = fit_classes(data, labels, given, factor, l2, *how, self.W)
        if self.uncertain:
            samples = [data]
            targets = [config.doubt * disagreement(X, labels.argmax(1), config.label_cells[-1])]
            each = config.noise_share * total / whole.noise_cells
            noise = self._noise(X, each, int(rng.integers(2**62)))
            if len(noise):
                samples.append(WeighedFeatures.of(noise, np.ones(len(noise)), self.hinges))
                targets.append(np.ones(len(noise)))
            last = fit_last_class(samples, targets, self.W, offset, factor, l2, *how)
            self.W = np.concatenate([self.W, last], axis=1)
            del samples
        del data, labels
        give_back()
        return self

    def _noise(self, X: np.ndarray, each: float, seed: int) -> np.ndarray:
        """Places (M, 3) where nothing was observed, `each` in every cell around points X (N, 3), and those
        beyond that wide kernels reach."""
        config, size = self.config, np.array(self.config.noise_cell)
        near = cells_around(X, size)
        parts = [noise_in(near, size, each, seed)]
        for cell, around in zip(config.far_cells, config.far_around):
            seed += MOST_EACH
            far = noise_in(cells_around(X, np.array(cell), around), np.array(cell), 1.0, seed)
            parts.append(far[~lie_in(far, near, size)])
        return np.concatenate(parts)

    @property
    def size(self) -> int:
        """Numbers that the map keeps."""
        return self.W.size + self._fitted().nodes.size

    def predict_labels(self, X: np.ndarray) -> Labels:
        """Labels of points (N, 3) [m], how doubtful each is, and whether its place was observed. Answers are
        not kept side by side: memory is that of some places."""
        X, parts = _in_space(X), []
        for start in range(0, max(len(X), 1), ROWS):
            known, uncertain = self.predict_known(X[start : start + ROWS])
            parts.append(Labels(known.argmax(axis=1), label_doubt(known), uncertain))
        return Labels(*(np.concatenate(part) for part in zip(*parts)))

    def predict_known(self, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Probabilities (N, C) of the classes but "uncertain" at points (N, 3) [m], and p(uncertain) (N,)."""
        every = self.predict_proba(X)
        if not self.uncertain:
            return every, 1 - every.max(axis=1)
        shares = every[:, :-1]
        shares /= shares.sum(axis=1, keepdims=True)
        return shares, every[:, -1]

    def predict_proba(self, X: np.ndarray) -> np.ndarray:
        """Class probabilities (N, C + 1) at points (N, 3) [m], the uncertain class last; (N, C) if there is
        none."""
        X = _in_space(X)
        columns = np.append(self.known, self.classes) if self.uncertain else self.known
        count = self.classes + self.uncertain
        return shares_at(X, self._fitted(), self.W, self._offset(), columns, count)

    def predict_lattice(self, axes: tuple[np.ndarray, ...]) -> np.ndarray:
        """Class probabilities (*lattice, C + 1) on the lattice that three coordinate arrays [m] span."""
        shape = tuple(len(axis) for axis in axes)
        out = np.empty((int(np.prod(shape)), self.classes + self.uncertain), np.float32)
        for start in range(0, len(out), ROWS):
            part = np.arange(start, min(start + ROWS, len(out)))
            places = [axis[index] for axis, index in zip(axes, np.unravel_index(part, shape))]
            out[part] = self.predict_proba(np.stack(places, axis=1))
        return out.reshape(*shape, -1)

    def save(self, path: Path) -> None:
        """Write the map as one .npz file, for `load`."""
        from mapping.multiscale_file import write_hinges

        write_hinges(path, self._fitted(), self.W, self.known, self.classes)

    def load(self, path: Path) -> MultiscaleMap:
        """Take up a map that `save` wrote. Raises DataError for other files."""
        from mapping.multiscale_file import read_hinges

        self.hinges, self.W, self.known, self.classes = read_hinges(path)
        self.uncertain = self.W.shape[1] > len(self.known)
        return self

    def _fitted(self) -> HashedHinges:
        if self.hinges is None:
            raise DataError("this map is not fitted yet; call fit(X, y, classes, rng)")
        return self.hinges

    def _offset(self) -> np.ndarray:
        # Kernels vanish far away and leave softmax(offset): fixed, not fitted.
        offset = np.zeros(len(self.known) + self.uncertain, np.float32)
        if self.uncertain:
            share = self.config.far_uncertainty
            offset[-1] = np.log(share / (1 - share) * len(self.known))
        return offset


def _in_space(X: np.ndarray) -> np.ndarray:
    """Points (N, 3), float64 unless they are float32 already, which cannot tell places in a city apart."""
    checked_points(X, dimensions=3)
    X = np.ascontiguousarray(X)
    return X if X.dtype == np.float32 else X.astype(np.float64, copy=False)
