"""What is seen of a cuboid, with the sides of it that are hidden.

Knows one object's measured points and readings of its depth image; knows nothing of maps, lattices or meshes.
Points are in the table frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.spatial import cKDTree

from reconstruction.surface.cuboid import Cuboid
from reconstruction.surface.cuboid_of_faces import Told, cuboid_of, off_faces
from reconstruction.surface.joint_surface import JointEdges
from reconstruction.surface.reading import Reading
from reconstruction.surface.seen_surface import Edges

FREE = 0.0002
"""Places at least so far before what was measured [m] are empty: rays over far edges end close by."""
CARRIED = 0.012
"""What was seen no farther than this before a place [m] may carry the object, rather than hide it."""
ATTACHED = 0.015
"""Hidden places this near to what was seen off the faces are left to the map [m]: handles, lids, labels."""

Bare = Callable[[np.ndarray], np.ndarray]
"""bare(points (N, 3) float32 [m]): (N,) whether nothing was measured there, and no mask has them either."""


@dataclass(frozen=True)
class BoxedEdges:
    """The edges of a cuboid: they say more of what is hidden.

    edges: what was measured; cuboid: what it is measured of; astray: (M, 3) float32 measured points that are
    not on its faces [m]; wall: what is measured is at least so thick [m].
    """

    never_hollow: ClassVar[bool] = True
    """Cartons have no cavity."""
    edges: Edges | JointEdges
    cuboid: Cuboid
    astray: np.ndarray
    wall: float

    @classmethod
    def of(
        cls, edges: Edges | JointEdges, points: np.ndarray, normals: np.ndarray, wall: float, bare: Bare
    ) -> BoxedEdges | None:
        """The same for points (N, 3) float32 measured of an object, normals (N, 3) into it; None where it
        is no cuboid.

        wall: the surface is so thick at least [m]. bare: of places where no depth image says anything.
        """
        one, other = edges.above_floor(np.array([0, 1], np.float32)).tolist()
        floor = None if one == other else -one

        def look(places: np.ndarray) -> Told:
            reading = edges.read(places)
            above = places[:, 2] > (-np.inf if floor is None else floor)
            empty = (reading.distance < -FREE) | bare(places)
            return Told(empty & above, (reading.others > 0) & (reading.others < CARRIED) & above)

        cuboid = cuboid_of(points, -normals, look, floor, edges.noise)
        if cuboid is None:
            return None
        return cls(edges, cuboid, points[off_faces(cuboid, points, edges.noise)], wall)

    def read(self, points: np.ndarray) -> Reading:
        """What the depth image says of points (N, 3) float32 [m], or the cuboid where it says nothing."""
        reading = self.edges.read(points)
        hidden = (reading.distance > 0) & (reading.depth > self.wall) & (reading.others > self.wall)
        rows = np.flatnonzero(hidden)
        deep = self.depth_known(points[rows])
        known = np.isfinite(deep)
        rows, deep = rows[known], deep[known]
        reading.distance[rows] = np.minimum(reading.distance[rows], deep)
        # Within, everything is the object's, as right behind what was measured; outside, the map has no say
        # either, or the faces would step from node to node of the lattice.
        reading.depth[rows] = np.where(deep >= 0, 0, np.minimum(reading.depth[rows], self.wall - deep))
        return reading

    def depth_known(self, points: np.ndarray) -> np.ndarray:
        """How deep points (N, 3) lie in the cuboid (N,) float32 [m], negative outside, there NaN near what
        is off its faces."""
        deep = self.cuboid.depth(points)
        if len(self.astray):
            apart = cKDTree(self.astray).query(points, distance_upper_bound=ATTACHED)[0]
            deep[(deep < 0) & (apart < ATTACHED)] = np.nan
        return deep

    def behind(self, points: np.ndarray, distance: float) -> np.ndarray:
        """Points (M, 3) that the object reaches to: within the cuboid, and points (N, 3) moved by `distance`
        [m] away from the camera."""
        return np.concatenate([self.edges.behind(points, distance), self.cuboid.faces(self.wall)])

    def above_floor(self, height: np.ndarray) -> np.ndarray:
        """How far heights (N,) are above the floor [m], FAR where none is known."""
        return self.edges.above_floor(height)
