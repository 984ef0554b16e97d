"""From log odds on a lattice to one closed surface with uncertainty. Knows lattices and meshes only."""

from __future__ import annotations

import numpy as np
import trimesh

from reconstruction.config import MeshConfig
from reconstruction.surface.closed_solid import ClosedSolid
from reconstruction.surface.field import Field
from reconstruction.surface.fusion import fuse
from reconstruction.surface.joint_surface import JointSurface
from reconstruction.surface.measured_vertices import share_left
from reconstruction.surface.refined import values_at
from reconstruction.surface.seen_cells import nodes_of_seen_cells
from reconstruction.surface.seen_surface import SeenSurface
from reconstruction.surface.simplified import simplified
from reconstruction.surface.unseen_walls import with_unseen_walls
from reconstruction.surface.whole_shape import WholeShape

RULED_OUT = -4.0
"""Where its log odds are below this, the map is sure that a node is not of the object, seen cell or not."""
SEEN_LOG_ODDS = 2.0
"""Log odds given to the nodes that seen cells are kept by."""


def extract_mesh(
    field: Field,
    index: int,
    config: MeshConfig,
    seen: np.ndarray | None = None,
    surface: SeenSurface | JointSurface | None = None,
    shape: WholeShape | None = None,
) -> tuple[trimesh.Trimesh, np.ndarray] | None:
    """Closed mesh of object `index` and p(uncertain) at its vertices (V,): the map's, as far as measurements
    leave it.

    In the field's frame. seen: points (N, 3) [m] on the object's surface, which the mesh is to keep.
    surface: what was measured of it, to be fused with the map; None leaves the surface to the map alone.
    shape: the same with the sides that are hidden, where these are known.
    Returns None when the object occupies no node of its window.
    """
    window = field.windows[index]
    log_odds, uncertainty, corner = field.log_odds[index], field.uncertainty[window], field.corner(window)
    if config.max_uncertainty is not None:
        # In the same units as the log odds, so that the surface stays smooth where the two meet.
        floor = np.log(config.max_uncertainty / (1 - config.max_uncertainty))
        shape = None  # what follows from what was seen is hidden all the same
        sure = floor - np.log(np.clip(uncertainty, 1e-6, 1 - 1e-6) / np.clip(1 - uncertainty, 1e-6, 1))
        log_odds = np.minimum(log_odds, sure)
    spacing, start, edges = field.spacing, np.zeros(3), None
    if surface is not None and seen is not None and min(log_odds.shape) > 1:
        edges = surface.edges(index)
        log_odds, start = fuse(log_odds, corner, spacing, shape or edges, seen, config.fusion)
        spacing /= config.fusion.refine
    elif seen is not None and config.keep_seen:
        log_odds = log_odds.copy()
        kept = nodes_of_seen_cells(log_odds, corner, spacing, seen, 0.0, RULED_OUT)
        log_odds[kept] = SEEN_LOG_ODDS
    cells = None
    if seen is not None and config.keep_seen:
        cells = np.floor(((seen - corner) / field.spacing - start) * (field.spacing / spacing)).astype(int)
    solid = ClosedSolid.of(log_odds, config.smallest_part, cells)
    if solid is None:
        return None
    if edges is not None and seen is not None and config.fusion.unseen_walls and solid.has_tunnel:
        first = corner + field.spacing * start
        walled = with_unseen_walls(log_odds, first, spacing, edges, seen)
        if walled is not None:
            solid = ClosedSolid.of(walled, config.smallest_part, cells) or solid
    vertices, faces = solid.surface()
    nodes = vertices * (spacing / field.spacing) + start  # of the map's lattice
    vertices = corner + field.spacing * nodes
    if config.simplify:
        vertices, faces = simplified(vertices, faces, config.simplify)
        nodes = (vertices - corner) / field.spacing
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    unsure = np.clip(values_at(uncertainty, nodes), 0, 1)
    return mesh, unsure if edges is None else unsure * share_left(edges, vertices)
