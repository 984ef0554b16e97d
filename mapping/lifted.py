"""Samples lifted to features: all that a fit works out of points and hinge points before it knows a label.

Knows points, hinge points and widths, and what was worked out of most of them before; must not know classes
or weights. Of several fits, each of most of the points of the one before, only what is new is worked out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mapping.known_points import among
from mapping.preconditioner import SparseFactor, extended_factor, sparse_factor
from mapping.renewed_tiles import renewed_features
from mapping.tiled_features import TiledFeatures, tiled_features

SCATTERED = 1.15
"""Tiles are made anew where those that were kept and added have so many times the columns that they had."""


@dataclass(frozen=True)
class Lifted:
    """Features of samples on a processor, and the factor of their correlations.

    X: (N, d) float32; hinges: (H, d) float32; gamma: (H,) float32; cutoff: smaller features are dropped;
    rank: (H,) the order in which the factor couples hinge points, None where it cannot be extended; width:
    columns a tile when all were last made anew.
    """

    X: np.ndarray
    hinges: np.ndarray
    gamma: np.ndarray
    cutoff: float
    features: TiledFeatures
    factor: SparseFactor
    rank: np.ndarray | None
    width: float

    @classmethod
    def of(
        cls,
        X: np.ndarray,
        hinges: np.ndarray,
        gamma: np.ndarray,
        cutoff: float,
        before: Lifted | None = None,
    ) -> Lifted:
        """Of samples X (N, d) and hinge points (H, d) of widths gamma (H,), all float32. before: of samples
        and hinge points of which many are the same, to the bit; what it says of these is kept."""
        kept = None if before is None or before.cutoff != cutoff else before._renewed(X, hinges, gamma)
        if kept is not None:
            return kept
        features = tiled_features(X, hinges, gamma, cutoff)
        factor = sparse_factor(hinges, gamma, features.nodes)
        rank = None if features.nodes is None else factor.rank
        return cls(X, hinges, gamma, cutoff, features, factor, rank, _width(features))

    def _renewed(self, X: np.ndarray, hinges: np.ndarray, gamma: np.ndarray) -> Lifted | None:
        """Of samples and hinge points that are mostly these; None where they are too few, or lie on no
        lattices."""
        if self.rank is None or X.shape[1] != 3:
            return None
        samples = _now(self.X, X)
        places = np.full(len(self.hinges), -1, np.int64)
        for width in np.unique(gamma):
            there, here = np.flatnonzero(self.gamma == width), np.flatnonzero(gamma == width)
            now = _now(self.hinges[there], hinges[here])
            places[there] = np.where(now >= 0, here[now], -1)
        features = renewed_features(self.features, X, samples, hinges, gamma, places, self.cutoff)
        if features is None or features.nodes is None or _width(features) > SCATTERED * self.width:
            return None
        factor = extended_factor(self.factor, self.rank, places, hinges, gamma, features.nodes)
        return Lifted(X, hinges, gamma, self.cutoff, features, factor, factor.rank, self.width)


def _width(features: TiledFeatures) -> float:
    """Columns that a tile has on average."""
    return sum(len(share.columns) for share in features.shares) / sum(
        len(share.starts) - 1 for share in features.shares
    )


def _now(earlier: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Which of points (N, 3) each of the earlier ones (M, 3) is now: (M,) int64, no two of them the same, -1
    where it is gone."""
    now = np.full(len(earlier), -1, np.int64)
    where = among(points, earlier)
    # The first of several in one place comes last.
    known = np.flatnonzero(where >= 0)[::-1]
    now[where[known]] = known
    return now
