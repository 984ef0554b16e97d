"""Labels of the `tabletop` preset: from a guess of the structure to label distributions.

Knows class distributions over {empty, object 1..K}; knows nothing of places. Labels are over {empty, object
1..K, uncertain}; p(uncertain) is to rank errors, so its share follows the chance that the answer is wrong.
"""

from __future__ import annotations

import numpy as np

from reconstruction.config import TabletopLabels

HOLLOW = 2.0
"""Odds of "uncertain" count so many times where a hidden sample is guessed to be an object's that is not
known to be filled: many are hollow. Of hidden places that maps of simulated scenes call an object's with a
chance of 0.9, a third are empty; of those that they call empty with that chance, a tenth are not."""
HOLLOW_WALL = 7.3
"""The same of a sample within a wall: of places that maps call an object's 5 to 10 mm behind what was seen of
it, half are empty."""
OUTSIDE_DOUBT = 0.5
"""Share of "uncertain" in the label of a sample outside the image, at least."""
OUTSIDE_LEAN = 1.6
"""Outside the image an object counts this many times against empty space ..."""
OUTSIDE_SHARP = 3.0
"""... and the likelier of the two counts by this power."""


def hidden(
    rules: TabletopLabels,
    structure: np.ndarray,
    least: float | None = None,
    filled: np.ndarray | None = None,
) -> np.ndarray:
    """Labels (N, K+2) of occluded samples with class distributions (N, K+1): what is there, as far as it
    is sure. least: in place of `least_uncertain`. filled: which samples (N,) lie in something known to
    have no cavity; None: it does not matter.

    The share of "uncertain" rises linearly with the chance that the likeliest class is wrong; and where that
    is an object, its odds are higher where it may be hollow.
    """
    least = rules.least_uncertain if least is None else least
    doubt = least + (rules.most_uncertain - least) * np.minimum(2 * (1 - structure.max(1)), 1)
    if filled is not None:
        doubt = np.where(filled | (structure.argmax(1) == 0), doubt, _times(HOLLOW, doubt))
    return np.column_stack([structure * (1 - doubt)[:, None], doubt])


def _times(factor: float, chance: np.ndarray) -> np.ndarray:
    """Chances (N,) whose odds count `factor` times."""
    return np.asarray(factor * chance / (1 + (factor - 1) * chance), chance.dtype)


def outside(rules: TabletopLabels, structure: np.ndarray) -> np.ndarray:
    """Labels (N, K+2) of samples outside the image with class distributions (N, K+1): unsure, for no ray
    could have passed there, but of the one shape that is likely to overlap most with the true one.

    Place by place a cut object ends where it is as likely as not; then half of what is likely is missing
    everywhere along its end.
    """
    doubt = hidden(rules, structure, OUTSIDE_DOUBT)[:, -1:]
    lean = structure.copy()
    lean[:, 1:] *= OUTSIDE_LEAN
    lean **= OUTSIDE_SHARP
    lean /= lean.sum(1, keepdims=True)
    return np.concatenate([lean * (1 - doubt), doubt], axis=1)


def pair(rules: TabletopLabels, classes: np.ndarray, doubt: np.ndarray, count: int) -> np.ndarray:
    """Labels (N, count + 1) of one side of surface pairs: the class (N,) seen there, and doubt (N,), the
    chance that it is another.

    Doubt, as behind the thin wall of a cup, goes to "uncertain" and to no other class: the surface was
    seen, and keeps its place.
    """
    return _owned(classes, doubt, (rules.pair_uncertain, rules.most_pair_uncertain), count)


def wall(
    rules: TabletopLabels, owner: np.ndarray, doubt: np.ndarray, count: int, filled: np.ndarray
) -> np.ndarray:
    """Labels (N, count + 1) of samples within the walls of classes owner (N,), with the chance (N,) that
    the wall ends before. filled: as in `hidden`.

    As in a pair, doubt goes to "uncertain" alone: a wall keeps its thickness, for a thinner one would
    have holes wherever the lattice misses it. Unlike a pair nobody has seen them.
    """
    doubt = np.where(filled, doubt, _times(HOLLOW_WALL, doubt))
    return _owned(owner, doubt, (rules.least_uncertain, rules.most_uncertain), count)


def foot(rules: TabletopLabels, above: np.ndarray) -> np.ndarray:
    """Labels (N, K+2) of samples under the support plane, with class distributions above (N, K+1) right
    over it: empty, and as uncertain as what stands there."""
    labels = hidden(rules, above)
    labels[:, 0] = 1 - labels[:, -1]
    labels[:, 1:-1] = 0
    return labels


def _owned(classes: np.ndarray, doubt: np.ndarray, uncertain: tuple[float, float], count: int) -> np.ndarray:
    """Labels of samples that belong to classes (N,) or to "uncertain", whose share rises with doubt (N,) from
    the first of two to the second."""
    least, most = uncertain
    labels = np.zeros((len(classes), count + 1), np.float32)
    labels[:, -1] = least + (most - least) * doubt
    labels[np.arange(len(classes)), classes] = 1 - labels[:, -1]
    return labels
