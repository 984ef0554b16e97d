"""How doubtful a label is, given that the place was observed.

Knows class shares; must not know how they were found. Two questions are apart: whether a place was observed
at all, which p(uncertain) answers, and whether the label there is right. The second is about what the labels'
shares look like among each other: where one is far ahead the label is sure, however little was seen, and
where two are level it is not, however much was.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

ROWS = 2**16
"""Places that are worked on at a time."""


class Labels(NamedTuple):
    """Of N places: label (N,) int64; doubt (N,) float32 in [0, 1] of that label, see `label_doubt`; uncertain
    (N,) float32, the chance that the place was not observed."""

    label: np.ndarray
    doubt: np.ndarray
    uncertain: np.ndarray


def label_doubt(shares: np.ndarray) -> np.ndarray:
    """(N,) float32: one minus the lead of the largest of a place's class shares (N, C) over the second; 0
    where there is one class.

    shares: sum to 1, p(uncertain) left out.
    """
    doubt = np.zeros(len(shares), np.float32)
    if shares.shape[1] > 1:
        for start in range(0, len(shares), ROWS):
            part = slice(start, start + ROWS)
            two = np.partition(shares[part], -2, axis=1)[:, -2:]
            doubt[part] = 1 - (two[:, 1] - two[:, 0])
    return doubt


def labels_of(probabilities: np.ndarray) -> Labels:
    """What probabilities (N, C + 1), the uncertain class last, say of N places."""
    uncertain = probabilities[:, -1].astype(np.float32)
    known = probabilities[:, :-1]
    shares = known / np.maximum(known.sum(axis=1, keepdims=True), np.finfo(np.float32).tiny)
    return Labels(shares.argmax(axis=1), label_doubt(shares), uncertain)
