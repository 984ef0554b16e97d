"""Labelled pixels, object by object. Written once because every step of cleaning asks for it."""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled


def masks_of(labels: np.ndarray) -> dict[int, np.ndarray]:
    """Label -> ascending flat indices of its pixels in labels (H, W); labels in the order they are met."""
    raw = labels.reshape(-1)
    labelled = np.flatnonzero(raw > 0)
    return {label: labelled[group] for label, group in group_by_label(raw[labelled])}


def group_by_label(label: np.ndarray) -> list[tuple[int, np.ndarray]]:
    """(label, ascending indices) of each value in label (N,) >= 0, in the order the values are first met.

    Image order, not label order: renumbering labels must not change a single bit of the result.
    """
    if label.size == 0:
        return []
    order, met, ends = _counted(label.astype(np.int64), int(label.max()) + 1)
    return [(name, order[ends[name - 1] if name else 0 : ends[name]]) for name in met.tolist()]


@compiled
def _counted(label: np.ndarray, values: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Indices (N,) of label (N,) < values, value after value; the values that are met, as they are met; and
    where the indices of each value end (values,). Counting is faster than sorting.
    """
    ends, met, count = np.zeros(values, np.int64), np.empty(values, np.int64), 0
    start = 0
    for index in range(1, len(label) + 1):
        if index == len(label) or label[index] != label[start]:  # neighbours mostly share their label
            if ends[label[start]] == 0:
                met[count] = label[start]
                count += 1
            ends[label[start]] += index - start
            start = index
    total = 0
    for value in range(values):
        total, ends[value] = total + ends[value], total
    order, value, place = np.empty(len(label), np.int64), label[0], ends[label[0]]
    for index in range(len(label)):
        if label[index] != value:
            ends[value] = place
            value = label[index]
            place = ends[value]
        order[place] = index
        place += 1
    ends[value] = place
    return order, met[:count], ends
