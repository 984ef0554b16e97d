"""A closed surface with fewer triangles, about as exact. Knows vertices and faces only."""

from __future__ import annotations

import numpy as np

from mapping.errors import ConfigError, DataError

ASKED = 0.8
"""manifold3d is asked for this share of a tolerance: many short collapses add up to more than each."""


def simplified(vertices: np.ndarray, faces: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Some of the vertices (N, 3) [m] of a closed surface, (V, 3), and faces (F, 3) between them, closed too.

    99 % of the surface moves by no more than `tolerance` [m], none of what stays by more than twice that;
    parts smaller than that go. Short edges and those within flat parts are collapsed. ConfigError without
    manifold3d, DataError when the surface is not closed.
    """
    try:
        import manifold3d
    except ImportError as error:
        raise ConfigError("mesh.simplify needs manifold3d: pip install 'contramap[export]'") from error

    solid = manifold3d.Manifold(manifold3d.Mesh(vertices.astype(np.float32), faces.astype(np.uint32)))
    if solid.status() != manifold3d.Error.NoError:
        raise DataError(f"a surface that is not closed cannot be simplified ({solid.status().name})")
    simple = solid.simplify(ASKED * tolerance).to_mesh()
    kept = np.asarray(simple.vert_properties)[:, :3].astype(np.float64)
    if not len(kept):  # all of it is smaller than that
        return vertices, faces
    return kept, np.asarray(simple.tri_verts).astype(faces.dtype)
