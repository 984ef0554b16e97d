"""Which object of one view is which of another: by the caller's numbers and names, else by where they are.

Knows observations in one table frame, each with its own labels; knows nothing of how they are joined.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from perception.frame import Frame
from perception.observation import Observation, ObservedObject
from perception.space import Space

TOUCHING = 0.006
"""Points this near to another view's points of an object lie on the same surface [m]."""
REACH = 0.03
"""Hidden points this far from what is seen of an object speak for it a third as much as those at it [m]."""
HIDDEN_SHARE = 0.5
"""A point hidden right behind an object's pixels speaks for it this much at most: it may be another's."""
LEAST = 0.08
"""Objects of two views are not the same with less than this share of their points speaking for it."""
FEW = 400
"""Points of an object that are asked."""


def same_number(a: Frame, b: Frame, label: int, track: bool) -> bool:
    """Whether a label means the same in two frames: the caller says so, or both give it the same name."""
    if track:
        return True
    return label in a.names and a.names.get(label) == b.names.get(label)


def match(
    frames: Sequence[Frame],
    observations: Sequence[Observation],
    spaces: Sequence[Space],
    track: bool,
    numbers: Sequence[int],
    settled: int = 0,
) -> tuple[list[dict[int, int]], list[str]]:
    """For each view own label -> joint label, and what was matched otherwise than by number, a line each.

    Joint labels are the first view's; a new object keeps its number where that is free. track: equal numbers
    are the same object in all frames. numbers: of the views; settled: so many of them have joint labels.
    """
    joint: dict[int, list[tuple[int, ObservedObject]]] = {}
    found: list[dict[int, int]] = []
    notes = []
    for view, observation in enumerate(observations):
        labels: dict[int, int] = {}
        for item in observation.objects:
            if view < settled:
                labels[item.label] = item.label
            known = joint.get(item.label, [])
            if any(
                own.label == item.label and same_number(frames[view], frames[other], item.label, track)
                for other, own in known
            ):
                labels[item.label] = item.label
        asked = [item for item in observation.objects if item.label not in labels]
        against = [] if track else [label for label in joint if label not in labels.values()]
        if asked and against:
            scores = np.array(
                [
                    [
                        max(_score(item, spaces[view], own, spaces[other]) for other, own in joint[label])
                        for label in against
                    ]
                    for item in asked
                ]
            )
            for row, column in zip(*linear_sum_assignment(-scores)):
                if scores[row, column] >= LEAST:
                    item, label = asked[row], against[column]
                    labels[item.label] = label
                    notes.append(
                        f"view {numbers[view]}: its {item.label} {item.name} is {label} "
                        f"{joint[label][0][1].name} by where it is ({scores[row, column]:.0%})"
                    )
        for item in observation.objects:
            if item.label not in labels:
                taken = {*joint, *labels.values()}
                labels[item.label] = item.label if item.label not in taken else max(taken) + 1
                if view:
                    notes.append(
                        f"view {numbers[view]}: its {item.label} {item.name} is in no view before it"
                    )
            joint.setdefault(labels[item.label], []).append((view, item))
        found.append(labels)
    return found, notes


def _score(a: ObservedObject, space_a: Space, b: ObservedObject, space_b: Space) -> float:
    """How much speaks for two objects of two views being one, 0..1."""
    return (_speaking(a, b, space_b) + _speaking(b, a, space_a)) / 2


def _speaking(item: ObservedObject, other: ObservedObject, space: Space) -> float:
    """Mean support of points of `item` for being the object `other` of another view, whose space is given:
    on its surface, or hidden behind its pixels and near."""
    points = item.points[:: 1 + len(item.points) // FEW]
    distance = cKDTree(other.points[:: 1 + len(other.points) // (4 * FEW)]).query(points)[0]
    sight = space.look(points)
    own = np.zeros(space.depth.size, bool)
    own[other.pixels] = True
    hidden = (sight.pixel >= 0) & own[sight.pixel] & (sight.behind > 0)
    vote = np.where(hidden, HIDDEN_SHARE * np.exp(-distance / REACH), 0.0)
    return float(np.where(distance < TOUCHING, 1.0, vote).mean())
