"""ContraMap: a kernel softmax map with one more class, "uncertain" (paper, Section III).

Points in R^d with class labels, plus noise samples labelled "uncertain", are lifted to Gaussian features
around hinge points; one linear softmax on these features answers structure and uncertainty anywhere.
This module knows points and classes; it knows nothing of cameras, images, objects or files.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch

from mapping.checks import (
    check_grid,
    check_reached,
    check_resolution,
    checked_classes,
    checked_points,
    checked_widths,
)
from mapping.config import MapConfig, ModelConfig
from mapping.errors import ConfigError, DataError
from mapping.hinges import grid_around
from mapping.kernels import PREDICT_CUTOFF, blocks, dense_features, groups_of_width
from mapping.lattice import LatticeEvaluator
from mapping.lifted import Lifted
from mapping.map_file import StoredMap, write_map
from mapping.preconditioner import SparseFactor, sparse_factor
from mapping.softmax import FitReport, fit_softmax
from mapping.sparse_features import SparseFeatures, sparse_features
from mapping.tiled_features import TiledFeatures

QUERIES = 200_000
"""Points whose sparse features are held at a time while predicting."""
REACHED = 0.05
"""A sample whose strongest feature is below this is out of the hinge points' reach."""


class ContraMap:
    """Softmax over W^T phi(x) with classes 0..C-1 and the uncertain class C, always the last column."""

    def __init__(self, config: ModelConfig | None = None):
        self.config = config or MapConfig()
        self.device = _device(self.config.device)
        self.report = FitReport()
        self.hinges = np.empty((0, 0), np.float32)
        self.gamma = np.empty(0, np.float32)
        self.W = torch.empty(0, 0)
        self.offset = torch.empty(0)

    @property
    def class_count(self) -> int:
        """C + 1, the uncertain class included."""
        return len(self.offset)

    def fit(
        self,
        X: np.ndarray,
        y: np.ndarray,
        hinges: np.ndarray | None = None,
        gamma: np.ndarray | float | None = None,
        weights: np.ndarray | None = None,
        classes: int | None = None,
        start: np.ndarray | None = None,
        lifted: Lifted | None = None,
    ) -> ContraMap:
        """Fit the weights (paper, Section III-B).

        X: (N, d) points; y: (N,) int classes, the uncertain class being the largest, or (N, C+1) float
        distributions; hinges: (H, d), default a grid of hinge_spacing around the data; gamma: scalar or
        (H,), default config.gamma; weights: (N,) > 0; classes: C + 1 when y may lack the last class;
        start: (H, C+1) weights that the fit begins with, default 0: it ends near where it would, but sooner;
        lifted: of X, hinges, gamma and config.fit_cutoff, where that is known already (on a processor).
        Raises DataError for wrong shapes, NaN or labels out of range.
        """
        X = checked_points(X)
        y, count = checked_classes(y, len(X), classes)
        soft = y.ndim == 2
        weights = np.ones(len(X), np.float32) if weights is None else np.asarray(weights, np.float32)
        if weights.shape != (len(X),) or not (weights > 0).all():
            raise DataError(f"weights must be {len(X)} numbers > 0, got shape {weights.shape}")
        if hinges is None:
            check_grid(X, self._own_grid().hinge_spacing)
            self.hinges = grid_around(X, self._own_grid().hinge_spacing)
        else:
            self.hinges = checked_points(hinges)
        if self.hinges.shape[1] != X.shape[1]:
            raise DataError(f"hinge points have {self.hinges.shape[1]} coordinates, points have {X.shape[1]}")
        width = self._own_grid().gamma if gamma is None else gamma
        self.gamma = checked_widths(width, len(self.hinges))
        check_resolution(X, self.gamma)
        self.offset = self._offset(count)
        features, order, strongest, factor = self._lifted(X, lifted)
        # The map says "uncertain" beyond its hinge points whatever lies there: samples out of reach would
        # only drive the outermost weights up.
        reached = strongest > REACHED
        check_reached(reached)
        weights = np.where(reached, weights[order], np.float32(0))
        weights_t = torch.from_numpy(weights / weights.sum()).to(self.device)
        targets = torch.from_numpy(y[order].astype(np.float32 if soft else np.int64)).to(self.device)
        self.W, self.report = fit_softmax(
            features,
            targets,
            weights_t,
            self.offset,
            factor.scaled,
            self.config.l2,
            self.config.fit,
            self._begin(start),
        )
        return self

    def predict_proba(self, X: np.ndarray) -> np.ndarray:
        """Class probabilities (N, C+1) float32 at points (N, d); the uncertain class is last."""
        return torch.softmax(self.logits(X), dim=1).cpu().numpy()

    def predict_known(self, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Probabilities (N, C) among the classes other than "uncertain", and p(uncertain) (N,)."""
        logits = self.logits(X)
        structure = torch.softmax(logits[:, :-1], 1)
        return structure.cpu().numpy(), torch.softmax(logits, 1)[:, -1].cpu().numpy()

    def logits(self, X: np.ndarray) -> torch.Tensor:
        """Logits (N, C+1) at points (N, d)."""
        X = self._asked(X)
        out = self.offset.repeat(len(X), 1)
        if len(X) == 0:
            return out
        if len(groups_of_width(self.gamma)) > 1:
            return self._logits_of_scales(X)
        X_t, hinges, gamma = self._tensors(X, self.hinges, self.gamma)
        for rows, near in blocks(X, self.hinges, self.gamma, PREDICT_CUTOFF):
            rows_t, near_t = self._tensors(rows, near)
            out[rows_t] += dense_features(X_t[rows_t], hinges[near_t], gamma[near_t]) @ self.W[near_t]
        return out

    def _logits_of_scales(self, X: np.ndarray) -> torch.Tensor:
        """Logits (N, C+1) of a map with widths far apart, from sparse features that keep all that matter."""
        out = self.offset.repeat(len(X), 1)
        for start in range(0, len(X), QUERIES):
            part = X[start : start + QUERIES]
            features = sparse_features(part, self.hinges, self.gamma, PREDICT_CUTOFF, self.device)
            out[features.order + start] += features.times(self.W)
        return out

    def lattice(self) -> LatticeEvaluator:
        """A function of d coordinate arrays that gives logits (C+1, *lattice) on the lattice they span."""
        self._check_fitted()
        return LatticeEvaluator(self.hinges, self.gamma, self.W, self.offset)

    def predict_lattice(self, axes: tuple[np.ndarray, ...]) -> np.ndarray:
        """Class probabilities (*lattice, C+1) float32 on a regular lattice; same values as predict_proba."""
        return torch.softmax(self.lattice()(axes), dim=0).movedim(0, -1).cpu().numpy()

    def predict_occupancy(self, X: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Probabilities (N, C+1), occupancy (N,) and its gradient (N, d) at points (N, d).

        Occupancy is P(class != 0) among the classes other than uncertain; class 0 is empty space.
        """
        X = self._asked(X)
        logits, slopes = self.logits(X), torch.zeros(len(X), X.shape[1], self.class_count, device=self.device)
        X_t, hinges, gamma = self._tensors(X, self.hinges, self.gamma)
        for rows, near in blocks(X, self.hinges, self.gamma, PREDICT_CUTOFF):
            rows_t, near_t = self._tensors(rows, near)
            phi = dense_features(X_t[rows_t], hinges[near_t], gamma[near_t]) * (-2 * gamma[near_t])
            for axis in range(X.shape[1]):
                difference = X_t[rows_t, None, axis] - hinges[None, near_t, axis]
                slopes[rows_t, axis] = (phi * difference) @ self.W[near_t]
        structure = torch.softmax(logits[:, :-1], dim=1)
        empty = structure[:, 0]
        # d empty = empty * (d logit_0 - sum_k p_k d logit_k)
        mean_slope = (slopes[:, :, :-1] * structure[:, None, :]).sum(2)
        gradient = -empty[:, None] * (slopes[:, :, 0] - mean_slope)
        probability = torch.softmax(logits, dim=1)
        return probability.cpu().numpy(), (1 - empty).cpu().numpy(), gradient.cpu().numpy()

    def save(self, path: str | Path) -> None:
        """Write the map as one .npz file; read it with mapping.load_map."""
        self._check_fitted()
        W, offset = self.W.cpu().numpy(), self.offset.cpu().numpy()
        losses, converged = self.report.losses, self.report.converged
        stored = StoredMap(self.hinges, self.gamma, W, offset, losses, converged, asdict(self.config))
        write_map(stored, Path(path))

    def _lifted(
        self, X: np.ndarray, lifted: Lifted | None
    ) -> tuple[TiledFeatures | SparseFeatures, np.ndarray, np.ndarray, SparseFactor]:
        """Features of samples (N, d) for the fit, the samples' order there, the strongest of each, and the
        factor of their correlations."""
        cutoff = self.config.fit_cutoff
        if self.device.type == "cpu":
            own = lifted or Lifted.of(X, self.hinges, self.gamma, cutoff)
            return own.features, own.features.order, own.features.strongest, own.factor
        found = sparse_features(X, self.hinges, self.gamma, cutoff, self.device)
        factor = sparse_factor(self.hinges, self.gamma, None, self.device)
        return found, found.order.cpu().numpy(), found.strongest.cpu().numpy(), factor

    def _begin(self, start: np.ndarray | None) -> torch.Tensor | None:
        """Where the fit begins, in the features that it sees."""
        if start is None:
            return None
        shape = (len(self.hinges), self.class_count)
        if np.shape(start) != shape or not np.isfinite(start).all():
            raise DataError(f"start must be {shape} finite weights, got shape {np.shape(start)}")
        return torch.from_numpy(np.ascontiguousarray(start, np.float32)).to(self.device)

    def _check_fitted(self) -> None:
        if not len(self.W) or len(self.W) != len(self.hinges):
            raise DataError("this map is not fitted yet; call fit(X, y), or read one with load_map(path)")

    def _asked(self, X: np.ndarray) -> np.ndarray:
        self._check_fitted()
        return checked_points(X, dimensions=self.hinges.shape[1])

    def _own_grid(self) -> MapConfig:
        if not isinstance(self.config, MapConfig):
            raise ConfigError("fit() needs hinges and gamma, or a MapConfig that says how to make them")
        return self.config

    def _offset(self, count: int) -> torch.Tensor:
        # Kernels vanish far away and leave softmax(offset): fixed, not fitted, so that a query out of reach
        # of every hinge point answers "uncertain" however the training data were balanced.
        offset = torch.zeros(count, device=self.device)
        empty = 0.0
        if self.config.empty_log_odds is not None:
            empty = self.config.empty_log_odds + float(np.log(max(count - 2, 1)))
        offset[0] = empty
        share = self.config.far_uncertainty
        if share is not None and count > 1:
            others = np.exp(empty) + count - 2
            offset[-1] = float(np.log(share / (1 - share) * others))
        return offset

    def _tensors(self, *arrays: np.ndarray) -> tuple[torch.Tensor, ...]:
        return tuple(torch.from_numpy(a).to(self.device) for a in arrays)


def _device(name: str) -> torch.device:
    # "auto" is the CPU: no test has yet shown that a graphics card answers the same, or sooner.
    if name == "cuda" and not torch.cuda.is_available():
        raise ConfigError("device cuda was asked for, but torch finds no CUDA device; use auto or cpu")
    return torch.device("cuda" if name == "cuda" else "cpu")
