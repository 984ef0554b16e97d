"""One real reconstruction of the tests' tabletop scene, made once, and the true meshes."""

from __future__ import annotations

from functools import cache

import numpy as np
import trimesh
from conftest import OBJECTS, make_tabletop, shape_mesh

from reconstruction.result import Reconstruction
from reconstruction.scene import reconstruct

KEYS = ("1_box_1", "2_sphere_2", "3_cylinder_3", "4_box_4")
BALL = 2
BALL_RADIUS = 0.04  # [m]


@cache
def reconstructed_tabletop() -> Reconstruction:
    """Four solids on a table, mapped from a small frame; shared, so tests must not change its arrays."""
    return reconstruct(make_tabletop(size=(240, 180)).frame)


def true_meshes() -> dict[int, trimesh.Trimesh]:
    """label -> true mesh in the world frame [m]."""
    meshes = [shape_mesh(shape) for shape in OBJECTS]
    return {
        index + 1: trimesh.Trimesh(np.asarray(mesh.vertices), np.asarray(mesh.triangles))
        for index, mesh in enumerate(meshes)
    }
