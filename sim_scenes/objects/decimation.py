"""Fewer triangles for meshes of the simulator. Knows meshes only."""

from __future__ import annotations

import numpy as np
import trimesh


def decimated(mesh: trimesh.Trimesh, faces: int) -> trimesh.Trimesh:
    """The mesh with about `faces` triangles, by quadric decimation; itself when it has no more.

    A closed mesh may come out open.
    """
    import open3d

    if len(mesh.faces) <= faces:
        return mesh
    full = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(np.asarray(mesh.vertices)),
        open3d.utility.Vector3iVector(np.asarray(mesh.faces)),
    )
    simple = full.simplify_quadric_decimation(faces)
    return trimesh.Trimesh(np.asarray(simple.vertices), np.asarray(simple.triangles))
