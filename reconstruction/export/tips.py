"""Tips of a mesh that its convex parts lack: simplification before the cut takes off what is thin.

Knows closed meshes only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh

from reconstruction.export.parts_error import lacking
from reconstruction.export.refine import refined

ROOT = 0.0005
"""A tip is all around a lacking place that is this far from the parts, and one ring of vertices more [m]."""


def tips(mesh: trimesh.Trimesh, parts: Sequence[trimesh.Trimesh], limit: float) -> list[trimesh.Trimesh]:
    """Convex parts for the tips of a closed mesh [m] that reach further than `limit` [m] from all others.

    They are halved until they bulge out of it by no more than that.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    vertices, edges = np.asarray(mesh.vertices), np.asarray(mesh.edges_unique)
    missing = lacking(vertices.astype(np.float32), parts)
    if (missing <= limit).all():
        return []
    inner = edges[(missing[edges] > ROOT).all(1)]
    graph = coo_matrix((np.ones(len(inner)), inner.T), (len(vertices), len(vertices)))
    _, of_vertex = connected_components(graph, directed=False)
    found = []
    for tip in np.unique(of_vertex[missing > limit]):
        own = of_vertex == tip
        found.append(vertices[np.unique(edges[own[edges].any(1)])])
    return refined(found, mesh, mesh, limit)
