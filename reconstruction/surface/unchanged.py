"""Whether a view more says anything new of an object, or leaves its surface where it is.

Knows one object's surface and what the view measured; knows nothing of maps or of how surfaces are made.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mapping.near_points import near_any
from reconstruction.surface.seen_surface import Edges

FEW = 0.02
"""A surface stays where no more than this share of it is contradicted or lacking."""
OFF = 0.002
"""What is measured this far from all vertices is not on the surface [m] ..."""
NOISES = 3.0
"""... nor nearer than this many standard deviations of the noise."""
SPREADS = 2.0
"""A ray contradicts vertices that are this many times as far before what it measured as views of one surface
differ."""
ASKED = 4000
"""Vertices, or measured points, that are asked, about."""


def unchanged(
    vertices: np.ndarray,
    new: Edges,
    spread: float,
    points: np.ndarray,
    earlier: Callable[[], np.ndarray],
) -> bool:
    """Whether a surface stays when a view is added.

    vertices: (V, 3) float32 of the surface [m, table frame]; new: the object's edges in the view; spread: by
    which views of one surface differ [m]; points: (N, 3) float32 [m] that it measured of the object; earlier:
    gives (M, 3) those that the surface was made from. What lacks as much of these lacks nothing new.
    """
    some = np.ascontiguousarray(vertices[:: 1 + len(vertices) // ASKED])
    off = max(OFF, SPREADS * spread)
    if (new.read(some).distance < -off).mean() > FEW:
        return False
    off = max(OFF, NOISES * new.noise)
    lacking = _lacking(points, vertices, off)
    return lacking <= FEW or lacking <= FEW + _lacking(earlier(), vertices, off)


def _lacking(points: np.ndarray, vertices: np.ndarray, off: float) -> float:
    """Share of points (N, 3) that are `off` [m] from all vertices (V, 3)."""
    points = points[:: 1 + len(points) // ASKED]
    return 1 - float(near_any(points, vertices, off).mean()) if len(points) else 0.0
