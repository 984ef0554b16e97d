"""What a view's prior answered before: a map of one view more asks about new places only.

Knows arrays of points and answers; knows nothing of what the answers mean.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any

import numpy as np

from mapping.known_points import among


def remembered(
    memo: dict[Any, Any], key: Hashable, points: np.ndarray, ask: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """ask(points): an answer (N, K) for each of points (N, 3) float32, which must not depend on the others.

    Those among the points of the last call with this memo and key are not asked again. The memo keeps the
    points and answers of this call alone, so that it grows no larger than they are: who writes into the
    answers copies them first.
    """
    if key not in memo:
        answers = ask(points)
    else:
        known, of_known = memo[key]
        where = among(points, known)
        new = np.flatnonzero(where < 0)
        answers = of_known[where]
        if len(new):
            answers[new] = ask(points[new])
    memo[key] = points, answers
    return answers
