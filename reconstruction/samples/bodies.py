"""Hidden points of objects whose whole shape is known from what is seen of them.

Knows guesses of what fills points, and how deep these lie in such bodies; knows nothing of how bodies are
found.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Protocol

import numpy as np

from mapping.compiled import compiled
from mapping.threads import map_in_threads

SURE = 0.8
"""So surely a hidden point is what a body says, unless it is near its surface: it is hidden all the same."""
NEAR = 0.004
"""Surfaces are known to about this [m]."""


_SURE, _NEAR = np.float32(SURE), np.float32(NEAR)


class Body(Protocol):
    """What is known of one object's shape."""

    never_hollow: ClassVar[bool]
    """Whether things of its kind have no cavity."""

    def depth_known(self, points: np.ndarray) -> np.ndarray:
        """How deep points (N, 3) [m] lie in it (N,) [m], negative outside, NaN where it says nothing."""


def with_bodies(
    guess: np.ndarray, points: np.ndarray, bodies: Sequence[Body | None]
) -> tuple[np.ndarray, np.ndarray]:
    """The guess (N, K+1) of {empty, object 1..K} at points (N, 3), given the bodies of the K objects; and
    which of the points (N,) lie in a body that is never hollow."""
    guess, filled = guess.copy(), np.zeros(len(points), np.bool_)
    known = [(own, body) for own, body in enumerate(bodies, start=1) if body is not None]
    depths = map_in_threads(lambda one: one[1].depth_known(points), known)
    for (own, body), depth in zip(known, depths):
        _say(guess, filled, own, depth, body.never_hollow)
    return guess, filled


@compiled
def _say(guess: np.ndarray, filled: np.ndarray, own: int, depth: np.ndarray, never_hollow: bool) -> None:
    """Put what a body of class `own` says into the guess (N, K+1), and into which points (N,) are filled.
    depth: (N,) [m], NaN where it says nothing."""
    one = np.float32(1)
    for i in range(len(depth)):
        deep = depth[i]
        if deep == 0 or np.isnan(deep):
            continue
        sure = _SURE * min(abs(deep) / _NEAR, one)
        if deep > 0:
            filled[i] |= never_hollow
            for k in range(guess.shape[1]):
                guess[i, k] *= one - sure
            guess[i, own] += sure
        else:
            guess[i, 0] += guess[i, own] * sure
            guess[i, own] *= one - sure
