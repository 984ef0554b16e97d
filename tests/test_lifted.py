"""Features that are kept from one fit to the next are those that would be worked out anew."""

import numpy as np
import pytest
import torch
from scipy import sparse

import mapping.renewed_tiles as renewed_tiles
from mapping.contramap import ContraMap
from mapping.lanes import LANES
from mapping.lifted import Lifted
from mapping.tiled_features import SHARED_FROM, TiledFeatures

CUTOFF = 0.02


def lattice(spacing: float, shape: tuple[int, int, int]) -> np.ndarray:
    axes = [spacing * np.arange(n, dtype=np.float32) for n in shape]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3).astype(np.float32)


COARSE, FINE = lattice(0.02, (12, 11, 6)), lattice(0.0125, (16, 15, 9))


def of_widths(coarse: np.ndarray, fine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    gamma = np.repeat(np.array([900, 4000], np.float32), [len(coarse), len(fine)])
    return np.concatenate([coarse, fine]), gamma


def samples(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, [0.22, 0.2, 0.1], (count, 3)).astype(np.float32)


def dense(features: TiledFeatures) -> np.ndarray:
    """Features (N, H) in the caller's order."""
    rows, columns, values, first = [], [], [], 0
    for share in features.shares:
        for t, (start, end) in enumerate(zip(share.starts[:-1], share.starts[1:])):
            rows.append(np.tile(np.arange(LANES), end - start) + LANES * (first + t))
            columns.append(np.repeat(share.columns[start:end], LANES))
            values.append(share.values[LANES * start : LANES * end])
        first += len(share.starts) - 1
    parts = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    found = sparse.csr_matrix(parts, (LANES * first, features.hinge_count)).toarray()
    out = np.empty((len(features.order), features.hinge_count), np.float32)
    out[features.order] = found[: len(out)]
    return out


@pytest.mark.parametrize("count", [1003, LANES * SHARED_FROM + 11])
def test_kept_features_are_those_of_the_samples_that_stay(
    count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A corner of the samples and of both lattices goes, another one comes.
    X = samples(count, 0)
    earlier = Lifted.of(X[X[:, 0] > 0.015], *of_widths(COARSE[COARSE[:, 0] > 0.03], FINE), CUTOFF)
    now = np.concatenate([samples(50, 1), X[X[:, 0] < 0.205], X[:3]])  # the last three are there twice
    hinges = of_widths(COARSE[COARSE[:, 0] < 0.19], FINE[FINE[:, 1] < 0.16])
    anew = Lifted.of(now, *hinges, CUTOFF)
    asked = []

    def counted(points: np.ndarray, nodes: object, cutoff: float) -> object:
        asked.append(len(points) if np.count_nonzero(nodes.ids >= 0) == len(hinges[0]) else 0)
        return in_reach(points, nodes, cutoff)

    in_reach = renewed_tiles.in_reach
    monkeypatch.setattr(renewed_tiles, "in_reach", counted)
    kept = Lifted.of(now, *hinges, CUTOFF, earlier)
    assert LANES * sum(asked) < 0.5 * len(now)  # the others were not lifted again
    assert asked
    assert sorted(kept.features.order) == list(range(len(now)))
    assert all(len(share.starts) > 1 for share in kept.features.shares)
    want, got = dense(anew.features), dense(kept.features)
    both = (want > CUTOFF + 1e-4) | (got > CUTOFF + 1e-4)  # at the bound itself rounding decides
    assert np.abs(want - got)[both].max() < 1e-5
    strongest = np.empty(len(now))
    strongest[kept.features.order] = kept.features.strongest
    np.testing.assert_allclose(strongest, got.max(1), atol=1e-6)


def test_an_extended_factor_is_as_good_as_a_new_one() -> None:
    X = samples(900, 0)
    earlier = Lifted.of(X, *of_widths(COARSE[COARSE[:, 0] > 0.05], FINE[:700]), CUTOFF)
    hinges, gamma = of_widths(COARSE[COARSE[:, 1] < 0.15], FINE[40:800])
    kept, anew = Lifted.of(X, hinges, gamma, CUTOFF, earlier), Lifted.of(X, hinges, gamma, CUTOFF)
    assert kept.rank is not None
    assert len(np.unique(kept.rank)) == len(hinges)
    squared = ((hinges[:, None].astype(float) - hinges[None]) ** 2).sum(2)
    total, product = gamma[:, None] + gamma, gamma[:, None] * gamma
    gram = (2 * np.sqrt(product) / total) ** 1.5 * np.exp(-product / total * squared)
    gram += 1e-3 * np.eye(len(hinges))
    off = []
    for lifted in (kept, anew):
        G = lifted.factor.scaled(torch.ones(len(hinges))).pull(torch.eye(len(hinges))).numpy().astype(float)
        whitened = G @ gram @ G.T
        np.testing.assert_allclose(np.diag(whitened), 1, atol=1e-3)
        off.append(np.linalg.norm(whitened - np.eye(len(hinges))))
    assert off[0] < 1.1 * off[1]


def test_other_points_are_lifted_anew() -> None:
    hinges = of_widths(COARSE, FINE)
    earlier = Lifted.of(samples(500, 0), *hinges, CUTOFF)
    other, want = (
        Lifted.of(samples(500, 1), *hinges, CUTOFF, earlier),
        Lifted.of(samples(500, 1), *hinges, CUTOFF),
    )
    np.testing.assert_array_equal(other.features.order, want.features.order)
    finer = Lifted.of(samples(500, 0), *hinges, 0.01, earlier)
    assert dense(finer.features)[dense(finer.features) > 0].min() < 0.012


def test_a_fit_of_kept_features_is_the_fit() -> None:
    X = samples(1500, 0)
    y = (X[:, 0] + 0.3 * X[:, 1] > 0.12).astype(int)
    y[::9] = 2
    earlier = Lifted.of(X[:1400], *of_widths(COARSE[60:], FINE), CUTOFF)
    hinges, gamma = of_widths(COARSE, FINE)
    lifted = Lifted.of(X, hinges, gamma, CUTOFF, earlier)
    own = ContraMap().fit(X, y, hinges, gamma)
    given = ContraMap().fit(X, y, hinges, gamma, lifted=Lifted.of(X, hinges, gamma, own.config.fit_cutoff))
    np.testing.assert_array_equal(own.W.numpy(), given.W.numpy())
    kept = ContraMap().fit(X, y, hinges, gamma, lifted=lifted)
    assert np.abs(kept.predict_proba(X) - own.predict_proba(X)).mean() < 0.02


def test_tiles_that_are_scattered_are_made_anew() -> None:
    """Samples that come and go leave tiles that reach ever farther, up to a bound."""
    hinges, X = of_widths(COARSE, FINE), samples(4000, 0)
    kept = first = Lifted.of(X, *hinges, CUTOFF)
    widths = []
    for seed in range(1, 25):
        X = np.concatenate([X[200:], samples(200, seed)])
        kept = Lifted.of(X, *hinges, CUTOFF, kept)
        shares = kept.features.shares
        widths.append(sum(len(s.columns) for s in shares) / sum(len(s.starts) - 1 for s in shares))
    assert max(widths) > 1.05 * first.width
    assert max(widths) < 1.2 * first.width
