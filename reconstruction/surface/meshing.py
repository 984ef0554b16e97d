"""From log odds on lattices to closed surfaces with uncertainty, no two of which share a place.

Knows lattices and meshes only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import trimesh

from reconstruction.config import MeshConfig
from reconstruction.surface.closed_solid import ClosedSolid
from reconstruction.surface.exclusive import exclusive
from reconstruction.surface.faired import faired
from reconstruction.surface.field import Field
from reconstruction.surface.fusion import fuse
from reconstruction.surface.joint_surface import JointEdges, JointSurface
from reconstruction.surface.measured_vertices import free_to_move, share_left
from reconstruction.surface.refined import values_at
from reconstruction.surface.revolved import RevolvedEdges
from reconstruction.surface.seen_cells import nodes_of_seen_cells
from reconstruction.surface.seen_surface import Edges, SeenSurface
from reconstruction.surface.simplified import simplified
from reconstruction.surface.unseen_walls import with_unseen_walls
from reconstruction.surface.whole_shape import WholeShape

RULED_OUT = -4.0
"""Where its log odds are below this, the map is sure that a node is not of the object, seen cell or not."""
SEEN_LOG_ODDS = 2.0
"""Log odds given to the nodes that seen cells are kept by."""
MOVED = 1.0
"""Fairing moves a vertex by no more than so many cells."""

GUESSED, KNOWN, THIN_WALLED = range(3)
"""Which object yields where two claim a place: what the map guesses to what follows from what was seen, and a
thing that is full to a thin wall, which would get a hole."""


@dataclass(frozen=True)
class ObjectSolid:
    """What an object takes up, on a lattice `refine` times as fine as the field's.

    start: (3,) where the lattice that the solid was taken from begins, in nodes of the field's, from the
    corner of the object's window; rank: GUESSED, KNOWN or THIN_WALLED; edges: what was measured of it;
    cells: (N, 3) those of seen points, of the lattice that the solid was taken from.
    """

    solid: ClosedSolid
    start: np.ndarray
    refine: int
    rank: int
    edges: Edges | JointEdges | None
    cells: np.ndarray | None


def kept_apart(
    solids: Mapping[int, ObjectSolid | None], field: Field, config: MeshConfig
) -> dict[int, ObjectSolid | None]:
    """Solids of objects by their indices, where each place is one object's at most.

    An object of which nothing would be left stays as it was, and so does one of a single layer of nodes: its
    lattice is coarser.
    """
    found = dict(solids)
    finest = max((own.refine for own in solids.values() if own is not None), default=1)
    there = {index: own for index, own in sorted(solids.items()) if own is not None and own.refine == finest}
    firsts = {
        index: (np.array([part.start for part in field.windows[index]]) + own.start) * own.refine
        + own.solid.first
        for index, own in there.items()
    }
    lowered = exclusive(
        [own.solid.log_odds for own in there.values()],
        list(firsts.values()),
        [own.rank for own in there.values()],
    )
    for (index, own), log_odds in zip(there.items(), lowered):
        if log_odds is own.solid.log_odds:
            continue
        cells = None if own.cells is None else own.cells - own.solid.first
        left = ClosedSolid.of(log_odds, config.smallest_part, cells)
        if left is not None:
            found[index] = replace(own, solid=replace(left, first=left.first + own.solid.first))
    return found


def extract_mesh(
    field: Field,
    index: int,
    config: MeshConfig,
    seen: np.ndarray | None = None,
    surface: SeenSurface | JointSurface | None = None,
    shape: WholeShape | None = None,
) -> tuple[trimesh.Trimesh, np.ndarray] | None:
    """Closed mesh of object `index` and p(uncertain) at its vertices (V,): see object_solid, mesh_of."""
    found = object_solid(field, index, config, seen, surface, shape)
    return None if found is None else mesh_of(found, field, index, config)


def object_solid(
    field: Field,
    index: int,
    config: MeshConfig,
    seen: np.ndarray | None = None,
    surface: SeenSurface | JointSurface | None = None,
    shape: WholeShape | None = None,
) -> ObjectSolid | None:
    """What object `index` takes up: what the map says, as far as measurements leave it.

    seen: points (N, 3) [m] on the object's surface, which the solid is to keep.
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
    refine, start, edges = 1, np.zeros(3, int), None
    if surface is not None and seen is not None and min(log_odds.shape) > 1:
        edges = surface.edges(index)
        if isinstance(shape, RevolvedEdges):
            shape = shape.ended(log_odds, corner, field.spacing)
        log_odds, start = fuse(log_odds, corner, field.spacing, shape or edges, seen, config.fusion)
        refine = config.fusion.refine
    elif seen is not None and config.keep_seen:
        log_odds = log_odds.copy()
        kept = nodes_of_seen_cells(log_odds, corner, field.spacing, seen, 0.0, RULED_OUT)
        log_odds[kept] = SEEN_LOG_ODDS
    cells = None
    if seen is not None and config.keep_seen:
        cells = np.floor(((seen - corner) / field.spacing - start) * refine).astype(int)
    solid = ClosedSolid.of(log_odds, config.smallest_part, cells)
    if solid is None:
        return None
    if edges is not None and seen is not None and config.fusion.unseen_walls:
        lattice = corner + field.spacing * start, field.spacing / refine
        # Where the walls of a known shape are is known: their holes are closed there.
        vessel = shape.body if isinstance(shape, RevolvedEdges) and not shape.full else None
        for narrow in (True, False) if shape is not None else (False,):
            if not solid.has_tunnel:
                break
            walled = with_unseen_walls(log_odds, *lattice, edges, seen, narrow, vessel)
            if walled is not None:
                log_odds = walled
                solid = ClosedSolid.of(log_odds, config.smallest_part, cells) or solid
    return ObjectSolid(solid, start, refine, _rank_of(shape), edges, cells)


def mesh_of(
    found: ObjectSolid, field: Field, index: int, config: MeshConfig
) -> tuple[trimesh.Trimesh, np.ndarray]:
    """Closed mesh of what object `index` takes up, in the field's frame, and p(uncertain) at its vertices
    (V,)."""
    window = field.windows[index]
    corner, uncertainty = field.corner(window), field.uncertainty[window]
    vertices, faces = found.solid.surface()
    nodes = vertices / found.refine + found.start  # of the map's lattice
    vertices = corner + field.spacing * nodes
    if found.edges is not None and config.fusion.fair:
        lowest, free = vertices[:, 2].min(), free_to_move(found.edges, vertices)
        vertices = faired(vertices, faces, free, config.fusion.fair, MOVED * field.spacing / found.refine)
        vertices[:, 2] = np.maximum(vertices[:, 2], lowest)  # nothing reaches below the floor
        nodes = (vertices - corner) / field.spacing
    if config.simplify:
        vertices, faces = simplified(vertices, faces, config.simplify)
        nodes = (vertices - corner) / field.spacing
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    unsure = np.clip(values_at(uncertainty, nodes), 0, 1)
    return mesh, unsure if found.edges is None else unsure * share_left(found.edges, vertices)


def _rank_of(shape: WholeShape | None) -> int:
    if shape is None:
        return GUESSED
    return THIN_WALLED if isinstance(shape, RevolvedEdges) and not shape.full else KNOWN
