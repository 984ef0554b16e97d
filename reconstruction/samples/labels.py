"""Labels of the `tabletop` preset: from a guess of the structure to label distributions.

Knows class distributions over {empty, object 1..K}; knows nothing of places. Labels are over {empty, object
1..K, uncertain}; p(uncertain) is to rank errors, so its share follows the chance that the answer is wrong.
"""

from __future__ import annotations

import numpy as np

from reconstruction.config import TabletopLabels


def hidden(rules: TabletopLabels, structure: np.ndarray, least: float | None = None) -> np.ndarray:
    """Labels (N, K+2) of occluded samples with class distributions (N, K+1): what is there, as far as it
    is sure. least: in place of `least_uncertain`.

    The share of "uncertain" rises linearly with the chance that the likeliest class is wrong.
    """
    least = rules.least_uncertain if least is None else least
    doubt = least + (rules.most_uncertain - least) * np.minimum(2 * (1 - structure.max(1)), 1)
    return np.column_stack([structure * (1 - doubt)[:, None], doubt])


def pair(rules: TabletopLabels, classes: np.ndarray, doubt: np.ndarray, count: int) -> np.ndarray:
    """Labels (N, count + 1) of one side of surface pairs: the class (N,) seen there, and doubt (N,), the
    chance that it is another.

    Doubt, as behind the thin wall of a cup, goes to "uncertain" and to no other class: the surface was
    seen, and keeps its place.
    """
    return _owned(rules, classes, doubt, rules.most_pair_uncertain, count)


def wall(rules: TabletopLabels, owner: np.ndarray, doubt: np.ndarray, count: int) -> np.ndarray:
    """Labels (N, count + 1) of samples within the walls of classes owner (N,), with the chance (N,) that
    the wall ends before.

    As in a pair, doubt goes to "uncertain" alone: a wall keeps its thickness, for a thinner one would
    have holes wherever the lattice misses it.
    """
    return _owned(rules, owner, doubt, rules.most_uncertain, count)


def foot(rules: TabletopLabels, above: np.ndarray) -> np.ndarray:
    """Labels (N, K+2) of samples under the support plane, with class distributions above (N, K+1) right
    over it: empty, and as uncertain as what stands there."""
    labels = hidden(rules, above)
    labels[:, 0] = 1 - labels[:, -1]
    labels[:, 1:-1] = 0
    return labels


def _owned(
    rules: TabletopLabels, classes: np.ndarray, doubt: np.ndarray, most: float, count: int
) -> np.ndarray:
    """Labels of samples that belong to classes (N,) or to "uncertain", whose share rises to `most`."""
    labels = np.zeros((len(classes), count + 1), np.float32)
    labels[:, -1] = rules.pair_uncertain + (most - rules.pair_uncertain) * doubt
    labels[np.arange(len(classes)), classes] = 1 - labels[:, -1]
    return labels
