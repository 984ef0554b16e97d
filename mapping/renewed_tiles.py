"""Features of samples most of which had features before: tiles whose samples all stay are kept.

Knows tiles, and which samples and hinge points are which; knows nothing of classes or weights.
"""

from __future__ import annotations

import numpy as np

from mapping.compact_order import compact_order
from mapping.compiled import compiled
from mapping.hinge_nodes import HingeNodes
from mapping.lanes import LANES, every, larger, load, store
from mapping.threads import map_in_threads
from mapping.tiled_features import TiledFeatures, in_reach, points_of_tiles
from mapping.tiles import Tiles

LEAST_KEPT = 0.5
"""Where fewer tiles stay, all are made anew: those of scattered samples have more columns."""


def renewed_features(
    before: TiledFeatures,
    X: np.ndarray,
    samples: np.ndarray,
    hinges: np.ndarray,
    gamma: np.ndarray,
    places: np.ndarray,
    cutoff: float,
) -> TiledFeatures | None:
    """Truncated features of X (N, 3); those of earlier samples and hinge points are taken from `before`.

    samples, places: which of X, and of hinges (H, 3), each earlier one is now, -1 where it is gone. None
    where less than LEAST_KEPT of the tiles have all their samples still, or hinge points lie on no lattices.
    """
    count = -(-len(samples) // LANES)
    rows = np.full((count, LANES), -1, np.int64)
    rows.reshape(-1)[: len(samples)] = samples[before.order]
    stays = np.asarray((rows >= 0).all(1))
    nodes = HingeNodes.of(hinges, gamma, cutoff)
    if nodes is None or np.count_nonzero(stays) < LEAST_KEPT * max(count, -(-len(X) // LANES)):
        return None
    new = np.ones(len(X), bool)
    new[rows[stays]] = False
    rest = np.flatnonzero(new)
    rest = rest[compact_order(X[rest], LANES)]
    unknown = np.append(np.ones(len(hinges), bool), False)  # the last for nodes that are no hinge point
    unknown[places[places >= 0]] = False
    unknown_nodes = nodes._replace(ids=np.where(unknown[nodes.ids], nodes.ids, np.int32(-1)))
    ends = np.cumsum([0, *(len(share.starts) - 1 for share in before.shares)])
    pieces = len(before.shares)
    # Only the last tile of all may have fewer than its eight samples.
    cuts = [LANES * (-(-len(rest) // LANES) * k // pieces) for k in range(pieces)] + [len(rest)]

    def carry(number: int) -> tuple[Tiles, np.ndarray, np.ndarray]:
        own = slice(ends[number], ends[number + 1])
        kept, others = np.flatnonzero(stays[own]), rest[cuts[number] : cuts[number + 1]]
        order = rows[own][kept].reshape(-1)
        added, _ = in_reach(points_of_tiles(X[order]), unknown_nodes, np.float32(cutoff))
        tiles, further = in_reach(points_of_tiles(X[others]), nodes, np.float32(cutoff))
        carried, strongest = _carried(before.shares[number], kept, places, added, tiles)
        return carried, np.append(order, others), np.append(strongest, further[: len(others)])

    shares, order, strongest = zip(*map_in_threads(carry, range(pieces)))
    return TiledFeatures(np.concatenate(order), np.concatenate(strongest), list(shares), len(hinges), nodes)


@compiled
def _carried(
    tiles: Tiles, kept: np.ndarray, places: np.ndarray, added: Tiles, rest: Tiles
) -> tuple[Tiles, np.ndarray]:
    """Tiles `kept` (K,) of some, their columns now at places (-1: gone), each with those that are added to
    it, and then the rest; and the largest feature (8 K,) of each row of the kept ones."""
    count = len(kept)
    starts = np.zeros(count + len(rest.starts), np.int64)
    for i in range(count):
        found = added.starts[i + 1] - added.starts[i]
        for k in range(tiles.starts[kept[i]], tiles.starts[kept[i] + 1]):
            found += places[tiles.columns[k]] >= 0
        starts[i + 1] = starts[i] + found
    base = starts[count]
    for i in range(1, len(rest.starts)):
        starts[count + i] = base + rest.starts[i]
    columns = np.empty(starts[-1], np.int32)
    values, strongest = np.empty(LANES * len(columns), np.float32), np.empty(LANES * count, np.float32)
    for i in range(count):
        at, largest = starts[i], every(np.float32(0))
        for k in range(tiles.starts[kept[i]], tiles.starts[kept[i] + 1]):
            place = places[tiles.columns[k]]
            if place >= 0:
                value = load(tiles.values, LANES * k)
                columns[at] = place
                store(values, LANES * at, value)
                largest = larger(largest, value)
                at += 1
        for k in range(added.starts[i], added.starts[i + 1]):
            value = load(added.values, LANES * k)
            columns[at] = added.columns[k]
            store(values, LANES * at, value)
            largest = larger(largest, value)
            at += 1
        store(strongest, LANES * i, largest)
    columns[base:] = rest.columns
    values[LANES * base :] = rest.values
    return Tiles(starts, columns, values), strongest
