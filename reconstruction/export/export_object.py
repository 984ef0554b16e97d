"""One object as formats want it: meshes in its own frame, pose and mass. Knows no result and no format."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh

from perception.camera import transform


@dataclass(frozen=True)
class ExportObject:
    """One object: mesh and solid [m] in the object's frame (origin in its box's centre, z up).

    key: <label>_<name>, safe as a file and node name. mesh: the surface for the eye. solid: the surface that
    collisions are taken from; the mesh itself unless it was inflated.
    """

    key: str
    label: int
    name: str
    mesh: trimesh.Trimesh
    solid: trimesh.Trimesh
    T_world_object: np.ndarray
    extents: np.ndarray

    @property
    def position(self) -> list[float]:
        """Origin of the object's frame in the world [m]."""
        return [float(value) for value in self.T_world_object[:3, 3]]

    @cached_property
    def quaternion_xyzw(self) -> list[float]:
        """Unit quaternion x y z w of T_world_object, w >= 0."""
        from scipy.spatial.transform import Rotation

        values = Rotation.from_matrix(self.T_world_object[:3, :3]).as_quat(canonical=True)
        return [float(value) for value in values]

    @property
    def quaternion_wxyz(self) -> list[float]:
        """Unit quaternion w x y z of T_world_object, w >= 0."""
        x, y, z, w = self.quaternion_xyzw
        return [w, x, y, z]

    def inertia(self, density: float) -> tuple[float, np.ndarray, np.ndarray]:
        """Mass [kg], centre of mass (3,) [m] and inertia (3, 3) [kg m^2] about it, of an even density.

        All in the object's frame.
        """
        volume, centre, tensor = self._moments
        return density * volume, centre.copy(), density * tensor

    @cached_property
    def _moments(self) -> tuple[float, np.ndarray, np.ndarray]:
        """The same of density 1."""
        solid = self.mesh.copy()
        solid.density = 1.0
        return float(solid.mass), np.array(solid.center_mass), np.array(solid.moment_inertia)


def moved(mesh: trimesh.Trimesh, T: np.ndarray) -> trimesh.Trimesh:
    """A copy of a mesh under the rigid T (4, 4)."""
    return trimesh.Trimesh(transform(T, np.asarray(mesh.vertices, float)), mesh.faces, process=False)
