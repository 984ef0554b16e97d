"""Dense signed distance field of the whole scene with its gradient, and where nothing is known (npz)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from reconstruction.distance import DistanceField
from reconstruction.export.export_object import moved
from reconstruction.export.export_scene import ExportScene

STATEMENT = {
    "frame": "lattice axes; node (i, j, k) lies at T_world_lattice @ (spacing * (i, j, k), 1) in the world "
    "frame of "
    "the result; gradients are in the world frame",
    "unit": "m; gradient without unit",
    "quaternion": "none; T_world_lattice is a 4x4 matrix",
    "sign": "inside of objects negative",
    "unknown": "true where the camera saw nothing and the map does not know, inside of objects as well",
}


def write(scene: ExportScene, folder: Path) -> None:
    """field.npz: distance (nx, ny, nz) float32, gradient (nx, ny, nz, 3) float16, unknown (nx, ny, nz) bool,
    spacing, T_world_lattice (4, 4), labels (K,)."""
    solids = [moved(item.solid, item.T_world_object) for item in scene.obstacles]
    field = DistanceField(solids, scene.T_world_table, scene.result.map())
    T = scene.T_world_table.copy()
    T[:3, 3] += T[:3, :3] @ field.origin
    slopes = np.stack(np.gradient(field.distance, field.spacing), axis=-1)
    with (folder / "field.npz").open("wb") as file:
        np.savez(
            file,
            allow_pickle=False,
            distance=field.distance,
            gradient=(slopes @ T[:3, :3].T).astype(np.float16),
            unknown=field.unknown,
            spacing=np.float64(field.spacing),
            T_world_lattice=T,
            labels=np.array([item.label for item in scene.objects], np.int64),
        )
