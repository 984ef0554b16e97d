"""How much of a surface's uncertainty is left where the surface was measured.

Knows readings of depth images; knows nothing of maps, lattices or meshes. The map's p(uncertain) says whether
a place was observed; around a surface it changes within millimetres from one to the other. A vertex lies on
what was measured, or it does not.
"""

from __future__ import annotations

import numpy as np

from reconstruction.surface.joint_surface import JointEdges
from reconstruction.surface.seen_surface import Edges

WITHIN, NOISES, MOST = 0.002, 3.0, 0.004
"""What lies no farther than this [m], or these standard deviations of noise, from what its ray measured of
the object is more or less that; no more than the last [m]: the far side of a thin wall is not."""
LEAST = 0.05
"""Share of the uncertainty that measured places keep."""


def share_left(edges: Edges | JointEdges, points: np.ndarray, before: np.ndarray | None = None) -> np.ndarray:
    """Share (N,) of the uncertainty at vertices (N, 3) [m] that measurements leave: LEAST on what was
    measured, 1 away from it and where no ray shows the object.

    before: (N,) what all views but the last leave, if that is known.
    """
    points = np.ascontiguousarray(points, np.float32)
    left = np.ones(len(points), np.float32) if before is None else before.copy()
    views = edges.views if isinstance(edges, JointEdges) else (edges,)
    for view in views if before is None else views[-1:]:
        view.leave(points, min(max(WITHIN, NOISES * view.noise), MOST), LEAST, left)
    return left
