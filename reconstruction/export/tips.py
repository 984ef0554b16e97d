"""Tips of a mesh that its convex parts lack: simplification before the cut takes off what is thin.

Knows closed meshes only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh

from reconstruction.export.cutting import Cutter, solid_of
from reconstruction.export.hulls import Hull
from reconstruction.export.parts_error import Union
from reconstruction.export.refine import refined
from reconstruction.solid import Solid

ROOT = 0.0012
"""A tip is all around a lacking place that is this far from the parts, and one ring of vertices more [m]:
simplification takes that much off anywhere."""


def tips(mesh: trimesh.Trimesh, parts: Sequence[Hull], limit: float) -> list[Hull]:
    """Convex parts for the tips of a closed mesh [m] that reach further than `limit` [m] from all others.

    They are halved until they bulge out of it by no more than that.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    vertices, edges = np.asarray(mesh.vertices), np.asarray(mesh.edges_unique)
    lacks = _lacking_regions(vertices.astype(np.float32), edges, parts, limit)
    if not lacks.any():
        return []
    inner = edges[lacks[edges].all(1)]
    graph = coo_matrix((np.ones(len(inner)), inner.T), (len(vertices), len(vertices)))
    _, of_vertex = connected_components(graph, directed=False)
    found = []
    for tip in np.unique(of_vertex[lacks]):
        own = of_vertex == tip
        found.append(vertices[np.unique(edges[own[edges].any(1)])])
    cutter = Cutter(solid_of(vertices, mesh.faces), found)
    return refined(cutter.hulls, Solid(mesh), cutter.halve, limit)


def _lacking_regions(
    corners: np.ndarray, edges: np.ndarray, parts: Sequence[Hull], limit: float
) -> np.ndarray:
    """Which of corners (N, 3) are further than `limit` [m] from all parts, or than ROOT and joined to such by
    edges (M, 2) between such: (N,) bool."""
    union = Union(parts)
    lacks = union.lacking(corners, limit) > 0
    asked = lacks.copy()
    while True:
        # Ring by ring: asking all vertices which parts they are in would take longer than the rest.
        ring = np.unique(edges[lacks[edges].any(1)])
        ring = ring[~asked[ring]]
        asked[ring] = True
        new = ring[union.lacking(corners[ring], ROOT) > 0]
        if len(new) == 0:
            return lacks
        lacks[new] = True
