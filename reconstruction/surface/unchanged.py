"""Whether a view more leaves an object's surface where it is, so that it need not be made again.

Knows one object's surface, its map before and after, and what views measured; knows nothing of how surfaces
are made.
"""

from __future__ import annotations

import numpy as np
import trimesh

from mapping.near_points import near_any
from reconstruction.surface.field import Field
from reconstruction.surface.joint_surface import JointEdges
from reconstruction.surface.seen_surface import Edges

FEW = 0.02
"""A surface stays where no more than this share of it is contradicted, lacking, or guessed otherwise."""
OFF = 0.002
"""What is measured this far from all vertices is not on the surface, whatever the noise [m] ..."""
SPREADS = 2.0
"""... and no nearer than this many times by which views of one surface differ."""
VERTICES = 4000
"""Vertices that are asked, about."""


def unchanged(
    mesh: trimesh.Trimesh,
    before: tuple[np.ndarray, np.ndarray],
    field: Field,
    index: int,
    edges: JointEdges,
    new: Edges,
    points: np.ndarray,
    wall: float,
) -> bool:
    """Whether the surface of object `index` stays when a view is added.

    mesh: the surface [m, table frame]; before: origin (3,) [m] and nodes (nx, ny, nz) bool inside, of the
    lattice it was made from; field: the map with the new view; edges: of all views, new: of the new one;
    points: (N, 3) float32 [m] that it measured of the object; wall: what was measured is so thick at least.
    """
    vertices = np.asarray(mesh.vertices, np.float32)
    some = np.ascontiguousarray(vertices[:: 1 + len(vertices) // VERTICES])
    off = max(OFF, SPREADS * edges.spread)
    if (new.read(some).distance < -off).mean() > FEW:
        return False
    if len(points) and 1 - near_any(points, vertices, off).mean() > FEW:
        return False
    few = FEW * float(mesh.area) / field.spacing**2
    return _guessed_otherwise(*before, field, index, edges, wall) <= few


def _guessed_otherwise(
    origin: np.ndarray,
    inside: np.ndarray,
    field: Field,
    index: int,
    edges: JointEdges,
    wall: float,
) -> int:
    """How many nodes that no view has measured are inside the object now and were not, or the reverse."""
    corner = field.corner(field.windows[index])
    now = field.log_odds[index] > 0
    shift = np.rint((origin - corner) / field.spacing).astype(int)
    low, high = np.minimum(shift, 0), np.maximum(shift + inside.shape, now.shape)
    then = np.zeros(high - low, bool)
    then[tuple(slice(a, a + n) for a, n in zip(shift - low, inside.shape))] = inside
    then[tuple(slice(a, a + n) for a, n in zip(-low, now.shape))] ^= now
    nodes = np.argwhere(then)
    places = (corner + field.spacing * (nodes + low)).astype(np.float32)
    reading = edges.read(places)
    unknown = (reading.distance > 0) & (reading.depth > wall) & (reading.others > wall)
    return int(np.count_nonzero(unknown))
