"""Which objects are such that their hidden sides follow from the seen ones. Knows which kinds there are."""

from __future__ import annotations

import numpy as np

from reconstruction.config import FusionConfig
from reconstruction.surface.boxed import Bare, BoxedEdges
from reconstruction.surface.joint_surface import JointEdges, normals_of
from reconstruction.surface.revolved import RevolvedEdges
from reconstruction.surface.seen_surface import Edges

POINTS = 1500
"""About as many measured points are looked at: with fewer, noise makes steps in a bowl's hidden wall."""
FLAT_ONES = 3
"""One in so many of these is enough for faces."""
LEAST_POINTS = 100
"""Fewer say too little of a shape."""

WholeShape = BoxedEdges | RevolvedEdges
"""An object's edges, and what they say of its hidden sides."""


def whole_shape(
    edges: Edges | JointEdges, points: np.ndarray, config: FusionConfig, bare: Bare
) -> WholeShape | None:
    """What points (N, 3) [m] measured of an object show it to be; None where that is not known.

    bare: of places where no depth image says anything.
    """
    points = np.ascontiguousarray(points[:: 1 + len(points) // POINTS], np.float32)
    normals = normals_of(edges, points)
    shown = normals.any(1)
    if np.count_nonzero(shown) < LEAST_POINTS:
        return None
    seen = points[shown], normals[shown], config.wall
    shape: WholeShape | None = None
    if config.round_bodies:
        shape = RevolvedEdges.of(edges, *seen, upright=True)
    if shape is None and config.cuboids:
        few = slice(None, None, FLAT_ONES)
        shape = BoxedEdges.of(edges, points[shown][few], normals[shown][few], config.wall, bare)
    if shape is None and config.round_bodies:
        shape = RevolvedEdges.of(edges, *seen, upright=False)
    return shape
