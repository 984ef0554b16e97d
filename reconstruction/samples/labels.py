"""Labels of the `tabletop` preset: from a guess of the structure to label distributions.

Knows class distributions over {empty, object 1..K}; knows nothing of places. Labels are over {empty, object
1..K, uncertain}; p(uncertain) is to rank errors, so its share follows the chance that the answer is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class TabletopLabels:
    """How sure the labels are."""

    least_uncertain: float = 0.06
    """Share of "uncertain" in the label of an occluded sample whose structure is beyond doubt."""
    most_uncertain: float = 0.95
    """Share of "uncertain" in the label of a sample of which nothing is known."""
    pair_uncertain: float = 0.02
    """Share of "uncertain" in the labels of a surface pair that nothing speaks against."""
    most_pair_uncertain: float = 0.8
    """Share of "uncertain" in the label of a sample right behind a seen surface that the prior takes for
    empty: a very thin wall. More ranks errors better and tears more holes into walls."""

    def hidden(self, structure: np.ndarray, least: float | None = None) -> np.ndarray:
        """Labels (N, K+2) of occluded samples with class distributions (N, K+1): what is there, as far as it
        is sure. least: in place of `least_uncertain`.

        The share of "uncertain" rises linearly with the chance that the likeliest class is wrong.
        """
        least = self.least_uncertain if least is None else least
        doubt = least + (self.most_uncertain - least) * np.minimum(2 * (1 - structure.max(1)), 1)
        return np.column_stack([structure * (1 - doubt)[:, None], doubt])

    def pair(self, classes: np.ndarray, doubt: np.ndarray, count: int) -> np.ndarray:
        """Labels (N, count + 1) of one side of surface pairs: the class (N,) seen there, and doubt (N,), the
        chance that it is another.

        Doubt, as behind the thin wall of a cup, goes to "uncertain" and to no other class: the surface was
        seen, and keeps its place.
        """
        return self._owned(classes, doubt, self.most_pair_uncertain, count)

    def wall(self, owner: np.ndarray, doubt: np.ndarray, count: int) -> np.ndarray:
        """Labels (N, count + 1) of samples within the walls of classes owner (N,), with the chance (N,) that
        the wall ends before.

        As in a pair, doubt goes to "uncertain" alone: a wall keeps its thickness, for a thinner one would
        have holes wherever the lattice misses it.
        """
        return self._owned(owner, doubt, self.most_uncertain, count)

    def foot(self, above: np.ndarray) -> np.ndarray:
        """Labels (N, K+2) of samples under the support plane, with class distributions above (N, K+1) right
        over it: empty, and as uncertain as what stands there."""
        labels = self.hidden(above)
        labels[:, 0] = 1 - labels[:, -1]
        labels[:, 1:-1] = 0
        return labels

    def _owned(self, classes: np.ndarray, doubt: np.ndarray, most: float, count: int) -> np.ndarray:
        """Labels of samples that belong to classes (N,) or to "uncertain", whose share rises to `most`."""
        labels = np.zeros((len(classes), count + 1), np.float32)
        labels[:, -1] = self.pair_uncertain + (most - self.pair_uncertain) * doubt
        labels[np.arange(len(classes)), classes] = 1 - labels[:, -1]
        return labels
