"""Which vertices of a surface were measured: how much uncertainty is left there, how freely they may move.

Knows readings of depth images; knows nothing of maps, lattices or meshes. The map's p(uncertain) says whether
a place was observed; around a surface it changes within millimetres from one to the other. A vertex lies on
what was measured, or it does not.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from reconstruction.surface.joint_surface import JointEdges
from reconstruction.surface.seen_surface import Edges

WITHIN, NOISES, MOST = 0.002, 3.0, 0.004
"""What lies no farther than this [m], or these standard deviations of noise, from what its ray measured of
the object is more or less that; no more than the last [m]: the far side of a thin wall is not."""
LEAST = 0.05
"""Share of the uncertainty that measured places keep."""
TORN = 2.0
"""Within so many pixels of an image's edge its surface may have teeth, which are not held."""


def share_left(edges: Edges | JointEdges, points: np.ndarray, before: np.ndarray | None = None) -> np.ndarray:
    """Share (N,) of the uncertainty at vertices (N, 3) [m] that measurements leave: LEAST on what was
    measured, 1 away from it and where no ray shows the object.

    before: (N,) what all views but the last leave, if that is known.
    """
    views = edges.views if isinstance(edges, JointEdges) else (edges,)
    share = np.ones(len(points), np.float32) if before is None else before.copy()
    off = _off(views if before is None else views[-1:], points, 0.0, share)
    return np.maximum(off, np.float32(LEAST))


def free_to_move(edges: Edges | JointEdges, points: np.ndarray) -> np.ndarray:
    """How freely (N,) vertices (N, 3) [m] may be moved: 0 on what was measured, 1 away from it, at the edges
    of the object's image and where no ray shows the object."""
    views = edges.views if isinstance(edges, JointEdges) else (edges,)
    return _off(views, points, TORN, np.ones(len(points), np.float32))


def _off(views: Sequence[Edges], points: np.ndarray, rim: float, share: np.ndarray) -> np.ndarray:
    """Shares (N,), lowered where any view measured vertices (N, 3) [m], and farther from its rim [px]."""
    points = np.ascontiguousarray(points, np.float32)
    for view in views:
        # What is no farther from what its ray measured was measured.
        view.lower_near(points, min(max(WITHIN, NOISES * view.noise), MOST), rim, share)
    return share
