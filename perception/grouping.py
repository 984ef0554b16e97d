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
    order, names, ends = _counted(label.astype(np.int64), int(label.max()) + 1)
    return list(zip(names.tolist(), np.split(order, ends[:-1])))


@compiled
def _counted(label: np.ndarray, values: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Indices (N,) of label (N,) < values, group after group; the groups' labels, and where each ends.

    Counting is faster than sorting, the more so by runs: neighbours mostly share their label.
    """
    starts = np.empty(len(label) + 1, np.int64)
    size = np.zeros(values, np.int64)
    names = np.empty(values, np.int64)
    runs, groups = 0, 0
    for index in range(len(label)):
        if index == 0 or label[index] != label[index - 1]:
            starts[runs] = index
            runs += 1
    starts[runs] = len(label)
    for run in range(runs):
        value = label[starts[run]]
        if size[value] == 0:
            names[groups] = value
            groups += 1
        size[value] += starts[run + 1] - starts[run]
    names = names[:groups].copy()
    ends = np.cumsum(size[names])
    place = size  # from here on, where the next index of each label goes
    place[names] = ends - size[names]
    order = np.empty(len(label), np.int64)
    for run in range(runs):
        start, end = starts[run], starts[run + 1]
        first = place[label[start]]
        order[first : first + end - start] = np.arange(start, end)
        place[label[start]] = first + end - start
    return order, names, ends
