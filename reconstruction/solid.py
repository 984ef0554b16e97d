"""A mesh made ready for questions: what lies inside it, and how far is its surface?"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import trimesh

from mapping.errors import DataError
from perception.ray_casting import ray_scene, tensor

OCCUPANCY_RAYS = 3
"""Rays that vote on inside or outside: scans touch themselves along edges, where one ray may miscount."""


class Solid:
    """A mesh [m] whose ray-casting scene is built once, however often it is asked."""

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        if len(mesh.faces) == 0:
            raise DataError("the mesh has no triangles")
        self.mesh = mesh

    def inside(self, points: np.ndarray) -> np.ndarray:
        """Which points (..., 3) [m] lie inside the closed mesh: (...) bool."""
        low, high = self.mesh.bounds
        # Most points of a grid lie outside the mesh's box: no ray has to be cast for them.
        box = ((points >= low) & (points <= high)).all(-1)
        found = np.zeros(box.shape, bool)
        if box.any():
            occupancy = self._scene.compute_occupancy(tensor(points[box]), nsamples=OCCUPANCY_RAYS)
            found[box] = occupancy.numpy() > 0.5
        return found

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Distance [m] of points (..., 3) to the nearest point of the surface: (...) float32."""
        return self._scene.compute_distance(tensor(points)).numpy()

    def cast(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Distance (N,) float32 at which rays from origins (N, 3) [m] first meet the surface, in lengths of
        their directions (N, 3); infinite where they miss."""
        rays = np.concatenate([origins, directions], axis=1)
        return self._scene.cast_rays(tensor(rays))["t_hit"].numpy()

    @cached_property
    def _scene(self) -> Any:
        return ray_scene([(self.mesh.vertices, self.mesh.faces)])
