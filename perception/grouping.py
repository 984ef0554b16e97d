"""Labelled pixels, object by object. Written once because every step of cleaning asks for it."""

from __future__ import annotations

import numpy as np


def group_by_label(label: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """(label, ascending indices) of each value in label (N,), in the order the values are first met.

    Image order, not label order: renumbering labels must not change a single bit of the result.
    """
    if label.size == 0:
        return []
    order = np.argsort(label, kind="stable")  # a radix sort for uint16
    value = label[order]
    begin = np.flatnonzero(np.concatenate([[True], value[1:] != value[:-1]]))
    groups = np.split(order, begin[1:])
    return [(int(label[group[0]]), group) for group in sorted(groups, key=lambda group: int(group[0]))]
