"""Tunnels through a solid that no ray is known to have passed, closed where the map thinks it likeliest.

A mug's bottom that neither the camera saw nor the map dared to guess leaves a tunnel from its cavity to the
outside; so do walls thinner than a lattice's cells. Nothing passed through them, so they are taken to be
closed: all of the hidden space is filled, then emptied again node by node, least likely ones first, as long
as no tunnel opens. What remains beside the solid is one node thick and closes it. A tunnel through which
rays passed, that of a mug's handle, stays: its nodes were never filled.

Knows lattices; knows nothing of images, maps or meshes.
"""

from __future__ import annotations

import numpy as np

LEVELS = (-6.0, -4.0, -2.5, -1.5, -0.75, 0.0)
"""Log odds up to which nodes are emptied, one level after the other: what is likelier stays longer."""
ROWS = np.array(list(np.ndindex(3, 3))) - 1
"""The nine rows of three nodes around a node."""
PLACES = ((ROWS[:, 0] + 1) * 16 + (ROWS[:, 1] + 1) * 4).astype(np.uint64)
"""Where a row's three bits stand in a word that holds a node's neighbourhood; the gaps between rows keep
shifts from running into the next one."""
MIDDLE = np.uint64(1 << 21)
"""The node itself in such a word."""
MOST_KNOWN = 200_000
"""So many neighbourhoods are kept, with whether their empty nodes are in one piece: 20 MB."""
_KNOWN: dict[int, bool] = {}
"""Fronts are short and look alike, in one object as in the next: most neighbourhoods were met before."""
ONE, FOUR, SIXTEEN = np.uint64(1), np.uint64(4), np.uint64(16)


def membranes(solid: np.ndarray, loose: np.ndarray, log_odds: np.ndarray) -> np.ndarray:
    """Loose nodes (nx, ny, nz) bool that, taken into a solid, close its tunnels through loose space.

    solid, loose: (nx, ny, nz) bool, apart from each other; loose: nodes that may be of the solid; none lies
    on the lattice's border. log_odds: (nx, ny, nz), how likely each of them is.
    """
    shape = solid.shape
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    left = loose.reshape(-1).copy()
    odds = log_odds.reshape(-1)
    empty = ~(solid | loose).reshape(-1)
    rows = empty.astype(np.uint8) << 1  # of each node: is it empty, and the nodes before and after it
    rows[1:] |= empty[:-1]
    rows[:-1] |= empty[1:].astype(np.uint8) << 2
    steps = ROWS @ strides[:2]
    beside = np.concatenate([strides, -strides])
    start = np.flatnonzero(left)
    x, y, z = np.unravel_index(start, shape)
    # Nodes of one class are no neighbours: emptying them at once is emptying them one by one.
    of_class = np.zeros(left.size, np.int8)
    of_class[start] = x % 2 * 4 + y % 2 * 2 + z % 2
    queued = np.zeros(left.size, bool)

    def around(nodes: np.ndarray) -> np.ndarray:
        """The empty nodes around nodes (M,), as words (M,) of bits."""
        words = rows.take(nodes[:, None] + steps).astype(np.uint64) << PLACES
        return np.bitwise_or.reduce(words, axis=1) & ~MIDDLE

    def simple(nodes: np.ndarray) -> np.ndarray:
        """Which nodes (M,) have empty nodes around them in one piece."""
        words = around(nodes).tolist()
        found = [_KNOWN.get(word) for word in words]
        if None in found:
            unknown = list({word for word, known in zip(words, found) if known is None})
            new = dict(zip(unknown, in_one_piece(np.array(unknown, np.uint64)).tolist()))
            found = [new[word] if known is None else known for word, known in zip(words, found)]
            if len(_KNOWN) < MOST_KNOWN:
                _KNOWN.update(new)
        return np.array(found, bool)

    for level in LEVELS:
        # Anew for each level: emptying a node may have freed one that is no direct neighbour.
        waiting = np.flatnonzero(left)
        waiting = waiting[odds[waiting] <= level]
        front = waiting[around(waiting) != 0]
        while len(front):
            found = []
            classes = of_class[front]
            for number in range(8):
                nodes = front[classes == number]
                nodes = nodes[simple(nodes)]
                left[nodes] = False
                rows[nodes] |= 2
                rows[nodes - 1] |= 4
                rows[nodes + 1] |= 1
                found.append(nodes)
            emptied = np.concatenate(found)
            found = []
            for step in beside:
                nodes = emptied + step
                nodes = nodes[left[nodes] & ~queued[nodes]]
                nodes = nodes[odds[nodes] <= level]
                queued[nodes] = True
                found.append(nodes)
            front = np.concatenate(found)
            queued[front] = False
    return left.reshape(shape)


def in_one_piece(words: np.ndarray) -> np.ndarray:
    """Whether the empty nodes around a node, as words (M,) of bits, are connected: one or more, in one piece.

    Nodes that touch at a corner are connected: a thin wall holds tight against those, too.
    """
    result = np.zeros(len(words), bool)
    index, reached = np.arange(len(words)), words & (~words + ONE)  # from the lowest bit on
    while len(index):
        grown = reached | reached << ONE | reached >> ONE
        grown |= grown << FOUR | grown >> FOUR
        grown |= grown << SIXTEEN | grown >> SIXTEEN
        grown &= words
        whole = grown == words
        result[index[whole]] = words[whole] != 0
        growing = ~whole & (grown != reached)
        index, words, reached = index[growing], words[growing], grown[growing]
    return result
