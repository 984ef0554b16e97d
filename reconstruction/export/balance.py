"""Where the mass of something seen at rest must be, so that what it touches can hold it.

The inside of an object is guessed, and so is its even density: where the two would let it fall over, the
centre of mass is elsewhere. Knows places where an object is pushed and a centre of mass; knows nothing of
objects or formats.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reconstruction.export.contacts import FOOT, Contacts

STEADY = 0.002
"""What holds an object wherever within this of its centre of mass the mass is, holds it [m]."""
WITHIN = 0.5
"""What rests on others, or on blocks, is taken to do so within this share of the way from the middle of the
ground covered to its rim: it may settle on some of them alone."""
ENOUGH = 0.006
"""More room for the centre of mass than this is no better [m]."""
PRICE = 0.2
"""Room for the centre of mass that is worth moving it by one metre [m]."""
FARTHEST = 0.3
"""A centre of mass is moved no further than this share of the object's extent: then something else is
wrong."""
LEANING = 0.5
"""Nothing pushes an object aside at any place with more than this share of its weight."""
FRICTION = 0.5
"""Less than engines are told: what only just holds there does not count."""
CELL = 0.004
"""Of contacts this near to each other with like directions one is enough [m]."""
MOST = 100
"""Of contacts that do not push straight up at most so many are looked at."""
WAYS = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
"""In which the centre of mass may be wrong."""


@dataclass(frozen=True)
class Balance:
    """centre: (3,) [m], moved level to where the object is held. room: how far it may be wrong there [m]; -1
    where nothing within reach holds the object."""

    centre: np.ndarray
    room: float

    @property
    def steady(self) -> bool:
        return self.room >= STEADY


def balanced(centre: np.ndarray, contacts: Contacts, extent: float) -> Balance:
    """The centre of mass (3,) [m] of an object, moved level to where contacts hold it.

    It stays where it is when there is ENOUGH room. extent: the object's diameter from above [m]. For each way
    in which the centre may be wrong there have to be pushes within the cones of friction that balance the
    weight: a linear program.
    """
    from scipy.optimize import linprog

    if len(contacts.places) == 0:
        return Balance(centre, -1.0)
    near = _gathered(_thinned(contacts))
    pushes = _with_friction(near)
    count = len(pushes.places)
    arms = (pushes.places - centre) / extent
    wrench = np.concatenate([pushes.pushes, np.cross(arms, pushes.pushes)], axis=1).T  # (6, count)
    rows = len(WAYS) * 6
    equal, right = np.zeros((rows, len(WAYS) * count + 5)), np.zeros(rows)
    for number, way in enumerate(WAYS):
        first = 6 * number
        equal[first : first + 6, number * count : (number + 1) * count] = wrench
        right[first + 2] = 1.0
        # Moments about the centre: those of the pushes, and (-y, x, 0) of the weight at (x, y) from it.
        for column, (x, y) in enumerate([(1, 0), (-1, 0), (0, 1), (0, -1), way]):
            equal[first + 3, -5 + column] = -y
            equal[first + 4, -5 + column] = x
    cost = np.concatenate([np.zeros(len(WAYS) * count), np.full(4, PRICE), [-1.0]])
    leaning = int(np.count_nonzero(~near.carries))
    limit = ([(0, LEANING)] * leaning + [(0, None)] * (count - leaning)) * len(WAYS)
    limit += [(0, FARTHEST)] * 4 + [(0, ENOUGH / extent)]
    found = linprog(cost, A_eq=equal, b_eq=right, bounds=limit, method="highs")
    if not found.success:
        return Balance(centre, -1.0)
    right_by, left_by, on_by, back_by, room = found.x[-5:] * extent
    shift = np.array([right_by - left_by, on_by - back_by, 0.0])
    return Balance(centre + shift if np.abs(shift).max() > 1e-6 else centre, float(room))


def gathered(places: np.ndarray) -> np.ndarray:
    """Places (N, 3) drawn together to WITHIN of their way from the middle of the ground they cover."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        rim = places[ConvexHull(places[:, :2]).vertices, :2]
    except (QhullError, ValueError):  # on a line, or hardly any
        middle = places[:, :2].mean(0)
    else:
        a, b = rim[1:-1] - rim[0], rim[2:] - rim[0]
        areas = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        middle = rim[0] + ((a + b) * areas[:, None]).sum(0) / (3 * areas.sum())
    return np.column_stack([middle + WITHIN * (places[:, :2] - middle), places[:, 2]])


def room_within(centre: np.ndarray, places: np.ndarray) -> float:
    """How far inside of the ground that places (N, 3) cover a centre (3,) is [m]; less than 0 outside; -inf
    where they cover none."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(places[:, :2])
    except (QhullError, ValueError):
        return -np.inf
    return float(-(hull.equations[:, :2] @ centre[:2] + hull.equations[:, 2]).max())


def _gathered(contacts: Contacts) -> Contacts:
    """Contacts, those that carry drawn together unless all are on the support."""
    carries, places = contacts.carries, contacts.places.copy()
    if carries.any() and (places[carries, 2] > FOOT).any():
        places[carries] = gathered(places[carries])
    return Contacts(places, contacts.pushes)


def _thinned(contacts: Contacts) -> Contacts:
    """As few contacts as say nearly the same."""
    from scipy.spatial import ConvexHull, QhullError

    places, pushes = contacts.places, contacts.pushes
    up = pushes[:, 2] > 0.99
    level, other = np.flatnonzero(up), np.flatnonzero(~up)
    try:
        level = level[ConvexHull(places[level, :2]).vertices]
    except (QhullError, ValueError):  # on a line, or hardly any
        level = level[_first_of_each(np.round(places[level] / CELL))]
    other = other[_first_of_each(np.round(np.column_stack([places[other] / CELL, 2 * pushes[other]])))]
    other = other[:: 1 + len(other) // MOST]
    kept = np.concatenate([level, other])
    return Contacts(places[kept], pushes[kept])


def _first_of_each(rows: np.ndarray) -> np.ndarray:
    """Numbers of the first of equal rows (N, M), in order."""
    return np.sort(np.unique(rows, axis=0, return_index=True)[1])


def _with_friction(contacts: Contacts) -> Contacts:
    """Four pushes at each place that carries, which span the cone of friction.

    A level one at a place that only pushes aside, first: nothing presses an object against it until
    it moves, and what is wedged in between two such places slips.
    """
    carries = contacts.carries
    places, normals = contacts.places[carries], contacts.pushes[carries]
    aside = np.cross(normals, np.eye(3)[np.abs(normals).argmin(1)])
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    across = np.cross(normals, aside)
    pushes = [normals + FRICTION * way for way in (aside, -aside, across, -across)]
    level = contacts.pushes[~carries] * [1.0, 1.0, 0.0]
    return Contacts(
        np.concatenate([contacts.places[~carries], np.tile(places, (4, 1))]), np.concatenate([level, *pushes])
    )
