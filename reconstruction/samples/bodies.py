"""Hidden points of objects whose whole shape is known from what is seen of them.

Knows guesses of what fills points, and how deep these lie in such bodies; knows nothing of how bodies are
found.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Protocol

import numpy as np

SURE = 0.8
"""So surely a hidden point is what a body says, unless it is near its surface: it is hidden all the same."""
NEAR = 0.004
"""Surfaces are known to about this [m]."""


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
    for own, body in enumerate(bodies, start=1):
        if body is None:
            continue
        depth = np.nan_to_num(body.depth_known(points))
        filled |= body.never_hollow & (depth > 0)
        sure = (SURE * np.clip(np.abs(depth) / NEAR, 0, 1)).astype(guess.dtype)
        within, beyond = np.where(depth > 0, sure, 0), np.where(depth < 0, sure, 0)
        guess *= (1 - within)[:, None]
        guess[:, own] += within
        guess[:, 0] += guess[:, own] * beyond
        guess[:, own] *= 1 - beyond
    return guess, filled
