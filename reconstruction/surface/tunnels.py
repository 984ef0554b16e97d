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

from mapping.compiled import compiled

LEVELS = np.array([-6.0, -4.0, -2.5, -1.5, -0.75, 0.0])
"""Log odds up to which nodes are emptied, one level after the other: what is likelier stays longer."""
CLASSES = 8
"""Nodes are emptied class by class, of which no two nodes are neighbours: a front moves alike all round."""


def membranes(solid: np.ndarray, loose: np.ndarray, log_odds: np.ndarray) -> np.ndarray:
    """Loose nodes (nx, ny, nz) bool that, taken into a solid, close its tunnels through loose space.

    solid, loose: (nx, ny, nz) bool, apart from each other; loose: nodes that may be of the solid; none lies
    on the lattice's border. log_odds: (nx, ny, nz), how likely each of them is.
    """
    left = loose.copy()
    empty = ~(solid | loose).reshape(-1)
    rows = empty.astype(np.uint8) << 1  # of each node: is it empty, and the nodes before and after it
    rows[1:] |= empty[:-1]
    rows[:-1] |= empty[1:].astype(np.uint8) << 2
    odds = np.ascontiguousarray(log_odds, np.float32).reshape(-1)
    _empty_again(left.reshape(-1), odds, rows, solid.shape[1], solid.shape[2], LEVELS)
    return left


@compiled
def _empty_again(
    left: np.ndarray, odds: np.ndarray, rows: np.ndarray, ny: int, nz: int, levels: np.ndarray
) -> None:
    """Empties nodes of `left` (N,), keeping `rows` (N,) up to date, as long as no tunnel opens."""
    beside = (ny * nz, nz, 1, -ny * nz, -nz, -1)
    loose = np.flatnonzero(left)
    queued = np.zeros(len(left), np.bool_)
    # A front and the next one, sorted by class: of each class, its nodes and how many there are.
    front = np.empty((CLASSES, len(loose)), np.int64)
    ahead = np.empty_like(front)
    count, count_ahead = np.zeros(CLASSES, np.int64), np.zeros(CLASSES, np.int64)
    for level in levels:
        count[:] = 0
        loose = loose[left[loose]]
        # Anew for each level: emptying a node may have freed one that is no direct neighbour.
        for node in loose:
            if odds[node] <= level and _empty_around(rows, node, ny, nz):
                number = _class_of(node, ny, nz)
                front[number, count[number]] = node
                count[number] += 1
        while count.sum():
            count_ahead[:] = 0
            for number in range(CLASSES):
                emptied = 0
                for place in range(count[number]):
                    node = front[number, place]
                    if in_one_piece(_empty_around(rows, node, ny, nz)):
                        left[node] = False
                        rows[node] |= 2
                        rows[node - 1] |= 4
                        rows[node + 1] |= 1
                        front[number, emptied] = node
                        emptied += 1
                count[number] = emptied
            for number in range(CLASSES):
                for place in range(count[number]):
                    for step in beside:
                        node = front[number, place] + step
                        if left[node] and not queued[node] and odds[node] <= level:
                            queued[node] = True
                            next_number = _class_of(node, ny, nz)
                            ahead[next_number, count_ahead[next_number]] = node
                            count_ahead[next_number] += 1
            for number in range(CLASSES):
                for place in range(count_ahead[number]):
                    queued[ahead[number, place]] = False
            front, ahead = ahead, front
            count, count_ahead = count_ahead, count


@compiled
def _class_of(node: int, ny: int, nz: int) -> int:
    """Which of the eight classes a node is of: nodes of one class are no neighbours."""
    return node // (ny * nz) % 2 * 4 + node // nz % ny % 2 * 2 + node % nz % 2


@compiled
def _empty_around(rows: np.ndarray, node: int, ny: int, nz: int) -> np.uint64:
    """The empty nodes around a node as a word of bits, 16 * i + 4 * j + k for the node at (i, j, k) of 3^3:
    the gaps keep shifts from running into the next row."""
    word = np.uint64(0)
    for i in range(3):
        for j in range(3):
            row = np.uint64(rows[node + ((i - 1) * ny + j - 1) * nz])
            word |= row << np.uint64(16 * i + 4 * j)
    return word & ~np.uint64(1 << 21)  # not the node itself


@compiled
def in_one_piece(word: np.uint64) -> bool:
    """Whether the empty nodes around a node, as a word of bits, are connected: one or more, in one piece.

    Nodes that touch at a corner are connected: a thin wall holds tight against those, too.
    """
    one, four, sixteen = np.uint64(1), np.uint64(4), np.uint64(16)
    grown = word & (~word + one)  # from the lowest bit on
    reached = np.uint64(0)
    while grown != reached:
        reached = grown
        grown |= grown << one | grown >> one
        grown |= grown << four | grown >> four
        grown |= grown << sixteen | grown >> sixteen
        grown &= word
    return word != np.uint64(0) and grown == word
