"""What probably fills hidden points: the learned prior where it can be asked, else a thin shell.

Knows whom to ask; knows nothing of samples, labels or the fit.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from reconstruction.prior.evidence import hidden_labels
from reconstruction.samples.scope import Scope


def structure(scope: Scope, points: np.ndarray) -> np.ndarray:
    """(N, K+1) guess of {empty, object 1..K} at points (N, 3) behind what is seen."""
    if scope.config.prior == "learned" and scope.supported:
        # What lies under the plane is empty to the prior; a pair at an object's foot may reach below it.
        above = np.column_stack([points[:, :2], np.maximum(points[:, 2], 0)])
        return hidden_labels(scope.observation, scope.space, above)
    return _shell(scope, points)


def _shell(scope: Scope, points: np.ndarray) -> np.ndarray:
    """(N, K+1) guess of {empty, object 1..K} from the distance to each object's seen surface alone."""
    objects, shell = scope.observation.objects, scope.config.shell
    distance = np.stack([cKDTree(o.points[::4]).query(points)[0] for o in objects], 1)
    nearest = distance.argmin(1)
    rows = np.arange(len(points))
    inside = 1 / (1 + np.exp((distance[rows, nearest] - shell) / (0.3 * shell)))
    guess = np.zeros((len(points), len(objects) + 1), np.float32)
    guess[rows, nearest + 1] = inside
    guess[:, 0] = 1 - inside
    return guess
