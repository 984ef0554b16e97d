"""Pictures of scenes whose world frame has its origin far away: single precision needs it near.

Knows reconstructions; knows nothing of how pictures are drawn.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import trimesh

if TYPE_CHECKING:
    from reconstruction.result import Reconstruction

FAR = 100.0
"""Beyond this distance from the origin [m] single precision moves vertices by more than 4 micrometres."""

Truth = Mapping[int, trimesh.Trimesh]


def shift_of(T_world_table: np.ndarray) -> np.ndarray:
    """Where the origin of pictures lies in the world frame (3,) [m]: 0 when that is near enough."""
    table = T_world_table[:3, 3]
    return np.round(table) if np.abs(table).max() > FAR else np.zeros(3)


def near_origin(
    reconstruction: Reconstruction, truth: Truth | None = None
) -> tuple[Reconstruction, Truth | None]:
    """The same scene and truth in a world frame whose origin is near the table."""
    shift = shift_of(reconstruction.T_world_table)
    if not shift.any():
        return reconstruction, truth
    camera = reconstruction.frame.camera
    frame = replace(
        reconstruction.frame,
        camera=replace(camera, T_world_camera=shifted_pose(camera.T_world_camera, shift)),
    )
    objects = tuple(
        replace(
            item,
            mesh=shifted_mesh(item.mesh, shift),
            T_world_object=shifted_pose(item.T_world_object, shift),
        )
        for item in reconstruction.objects
    )
    other = reconstruction.other
    moved = replace(
        reconstruction,
        frame=frame,
        objects=objects,
        other=other and replace(other, mesh=shifted_mesh(other.mesh, shift)),
        T_world_table=shifted_pose(reconstruction.T_world_table, shift),
    )
    return moved, truth and {label: shifted_mesh(mesh, shift) for label, mesh in truth.items()}


def shifted_pose(T: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """T (4, 4) seen from an origin at shift (3,) [m]."""
    moved = np.array(T, float)
    moved[:3, 3] -= shift
    return moved


def shifted_mesh(mesh: trimesh.Trimesh, shift: np.ndarray) -> trimesh.Trimesh:
    """A mesh seen from an origin at shift (3,) [m]."""
    return trimesh.Trimesh(np.asarray(mesh.vertices) - shift, mesh.faces, process=False)
