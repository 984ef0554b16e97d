"""Which objects are such that their hidden sides follow from the seen ones. Knows which kinds there are."""

from __future__ import annotations

import numpy as np

from reconstruction.config import FusionConfig
from reconstruction.surface.boxed import Bare, BoxedEdges
from reconstruction.surface.joint_surface import JointEdges
from reconstruction.surface.revolved import RevolvedEdges
from reconstruction.surface.seen_surface import Edges

WholeShape = BoxedEdges | RevolvedEdges
"""An object's edges, and what they say of its hidden sides."""


def whole_shape(
    edges: Edges | JointEdges, points: np.ndarray, config: FusionConfig, bare: Bare
) -> WholeShape | None:
    """What points (N, 3) [m] measured of an object show it to be; None where that is not known.

    bare: of places where no depth image says anything.
    """
    shape: WholeShape | None = None
    if config.round_bodies:
        shape = RevolvedEdges.of(edges, points, config.wall, upright=True)
    if shape is None and config.cuboids:
        shape = BoxedEdges.of(edges, points, config.wall, bare)
    if shape is None and config.round_bodies:
        shape = RevolvedEdges.of(edges, points, config.wall, upright=False)
    return shape
