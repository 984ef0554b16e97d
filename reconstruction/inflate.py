"""Everything that an object may occupy: one closed mesh an object at a chosen probability, for cautious
planners.

Knows a stored result's map and meshes; knows nothing of formats.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from scipy import ndimage

from mapping.errors import ConfigError
from perception.camera import invert_rigid, transform
from reconstruction.solid import Solid

BEYOND = -20.0
"""Log odds outside of all that was evaluated."""


HELD = 0.5
"""The surface keeps about this distance from the object's mesh, in cells: edges that pass between nodes are
held, too ..."""
LEAST_HELD = 0.2
"""... and this from its vertices, which may be the tips of something sharp."""


@dataclass(frozen=True)
class InflateConfig:
    """How far and how finely possible space is looked for."""

    spacing: float = 0.005
    """Lattice spacing [m]."""
    margin: float = 0.05
    """What may be occupied reaches at most this far beyond an object's mesh [m]."""


def inflated_meshes(
    result: Any, probability: float, config: InflateConfig | None = None
) -> dict[int, trimesh.Trimesh]:
    """Label -> closed mesh [m, world frame] of all places the object occupies with more than `probability`.

    result: a StoredResult. It holds the object's own mesh, whatever the probability; the smaller that is, the
    larger the mesh. Raises ConfigError unless 0 < probability < 1.
    """
    if not 0 < probability < 1:
        raise ConfigError(f"the probability must lie between 0 and 1, got {probability:g}")
    config = config or InflateConfig()
    T_table_world = invert_rigid(result.T_world_table)
    meshes = {
        item.label: trimesh.Trimesh(
            transform(T_table_world, np.asarray(item.mesh.vertices, float)), item.mesh.faces, process=False
        )
        for item in result.objects
    }
    model, found = result.map(), {}
    for item in result.objects:
        mesh = _inflated(model, item.class_index, meshes[item.label], probability, config)
        mesh.vertices = transform(result.T_world_table, np.asarray(mesh.vertices))
        found[item.label] = mesh
    return found


def _inflated(
    model: Any, column: int, mesh: trimesh.Trimesh, probability: float, config: InflateConfig
) -> trimesh.Trimesh:
    """The surface around all that may be of class `column`, in the table frame."""
    from skimage.measure import marching_cubes

    low = np.floor((mesh.bounds[0] - config.margin) / config.spacing) * config.spacing
    shape = np.ceil((mesh.bounds[1] + config.margin - low) / config.spacing).astype(int)
    axes = [low[i] + config.spacing * np.arange(n) for i, n in enumerate(shape)]
    odds = may_be_occupied(model.predict_lattice(tuple(axes)), column)
    level = np.log(probability / (1 - probability))
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), -1).astype(np.float32)
    solid = Solid(mesh)
    depth = np.where(solid.inside(nodes), 1.0, -1.0) * solid.distance(nodes) / config.spacing
    # The mesh itself belongs to it: what was measured counts more than what the map says there.
    values = np.maximum(odds - level, depth + HELD).astype(np.float32)
    _hold(values, (np.asarray(mesh.vertices) - low) / config.spacing)
    values = _one_piece(values, solid.inside(nodes))
    values = np.where(np.abs(values) < 1e-4, np.float32(-1e-4), values)
    padded = np.pad(values, 1, constant_values=BEYOND)
    vertices, faces, _, _ = marching_cubes(padded, 0.0, gradient_direction="ascent", allow_degenerate=False)
    return trimesh.Trimesh(low + config.spacing * (vertices - 1), faces, process=False)


def _hold(values: np.ndarray, places: np.ndarray) -> None:
    """Raise a lattice's values where places (N, 3) [cells] between its nodes get less than LEAST_HELD."""
    cell = np.floor(places).astype(int)
    share = places - cell
    corners = cell[:, None] + np.indices((2, 2, 2)).reshape(3, -1).T  # (N, 8, 3)
    weights = np.where(corners > cell[:, None], share[:, None], 1 - share[:, None]).prod(-1)
    index = tuple(np.moveaxis(corners, -1, 0))
    lacking = LEAST_HELD - (weights * values[index]).sum(1)
    raised = (values[index] + lacking[:, None])[lacking > 0]
    np.maximum.at(values, tuple(axis[lacking > 0] for axis in index), raised.astype(np.float32))


def may_be_occupied(probability: np.ndarray, column: int) -> np.ndarray:
    """Log odds (...) that class `column` occupies a place; probability: (..., C + 1), the last one
    uncertain."""
    structure = np.maximum(1 - probability[..., -1], 1e-9)
    share = np.clip(probability[..., column] / structure, 1e-6, 1 - 1e-6)
    return np.log(share / (1 - share))


def _one_piece(values: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """The same lattice without pieces that the object has no part in, and without enclosed hollows."""
    pieces, _ = ndimage.label(values > 0)
    kept = np.unique(pieces[inside])
    values = np.where(np.isin(pieces, kept[kept > 0]), np.maximum(values, 1e-3), np.minimum(values, -1e-3))
    outside, count = ndimage.label(np.pad(values <= 0, 1, constant_values=True))
    if count == 1:
        return values
    hollow = ((outside > 0) & (outside != outside[0, 0, 0]))[1:-1, 1:-1, 1:-1]
    return np.where(hollow, 0.01, values)
