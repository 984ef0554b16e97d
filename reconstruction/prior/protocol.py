"""The face of anything that guesses what is hidden: points in, class distribution out.

The pipeline knows a prior by this alone; another one needs these two names and nothing else of this folder.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from reconstruction.prior.features import Evidence


class ShapePrior(Protocol):
    """Guesses which object, if any, fills a point that no ray has reached."""

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of what it looks at, at a point, in its own order."""

    def distribution(
        self,
        visible: Sequence[np.ndarray],
        origin: np.ndarray,
        evidence: Evidence,
        points: np.ndarray,
        floors: Sequence[float] | None = None,
    ) -> np.ndarray:
        """Class distribution (N, K+1) float32 over {empty, object 1..K} at points (N, 3) [m]; rows sum to 1.

        visible: (M, 3) visible points of each of the K objects; origin: (3,) where the rays start; evidence:
        what the rays say of points, for one object; floors: heights of the supports that the objects stand
        on, 0 by default. All in the table frame [m], z up.
        """
