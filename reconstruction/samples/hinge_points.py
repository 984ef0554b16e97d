"""Hinge points of the `tabletop` preset: lattices that are the finer the more there is to tell.

Knows points to be near of; knows nothing of what they are.
"""

from __future__ import annotations

import numpy as np

from mapping.hinges import lattice_near_points
from mapping.threads import map_in_threads
from reconstruction.config import TabletopSamples


def hinge_points(
    config: TabletopSamples, fine: np.ndarray, ground: np.ndarray, thin: np.ndarray, covered: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Hinge points (H, 3) and widths (H,): coarse over the covered space, finer near some points, finer
    still on seen surfaces and at feet, finest on thin walls. fine, ground, thin, covered: (N, 3) [m] each."""
    lattices = [
        (covered, 0.0, config.coarse_spacing, config.coarse_gamma),
        (fine, config.fine_distance, config.fine_spacing, config.fine_gamma),
    ]
    if config.finest_distance is not None:
        lattices.append((ground, config.finest_distance, config.finest_spacing, config.finest_gamma))
    if config.thin_spacing is not None and len(thin):
        lattices.append((thin, 0.0, config.thin_spacing, config.thin_gamma))
    points = map_in_threads(lambda lattice: lattice_near_points(*lattice[:3]), lattices)
    return np.concatenate(points), np.repeat([lattice[3] for lattice in lattices], [len(p) for p in points])
