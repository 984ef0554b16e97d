"""Things that hang together, as disjoint sets in one array, for compiled loops (Tarjan 1975).

Knows numbers of things; knows nothing of what they are. parent: (N,) an earlier thing of the same set, or,
for the first of a set, itself; np.arange(N) is N sets of one.
"""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled


@compiled
def root(parent: np.ndarray, thing: int) -> int:
    """The first thing of a thing's set; the ways there become shorter."""
    while parent[thing] != thing:
        parent[thing] = parent[parent[thing]]
        thing = parent[thing]
    return thing


@compiled
def join(parent: np.ndarray, one: int, other: int) -> None:
    """Make the sets of two things one."""
    a, b = root(parent, one), root(parent, other)
    parent[max(a, b)] = min(a, b)
