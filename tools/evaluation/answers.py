"""What one method says of one case: all that costs the method's own time, before any of it is judged."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import trimesh

from reconstruction.fitted_scene import Surface
from reconstruction.metrics import grid_around
from reconstruction.surface.meshing import RULED_OUT, SEEN_LOG_ODDS
from reconstruction.surface.seen_cells import nodes_of_seen_cells
from tools.evaluation.case import Case
from tools.evaluation.fitted_map import FittedMap
from tools.evaluation.methods import method
from tools.evaluation.uncertainty_card import distance_to_samples
from tools.stopwatch import Stopwatch

COARSE_SPACING = 0.015
"""Grid of V-PRISM's protocol [m]."""
FINE_SPACING = 0.005
"""Grid of the fine protocol [m]."""

Seconds = dict[str, float]
"""Wall-clock seconds of a stage under `<stage>_s`, this process's processor seconds under `<stage>_cpu_s`."""
DeliveredMeshes = dict[int, Surface]
"""Label -> mesh with uncertainty; objects without volume are missing."""


@dataclass(frozen=True)
class CoarseAnswer:
    """One object on V-PRISM's grid: where P(object) > 0.5 (n, n, n), and its mesh [m], None if nowhere."""

    occupied: np.ndarray
    mesh: trimesh.Trimesh | None


@dataclass(frozen=True)
class Answers:
    """One fit's answers on one case.

    probability (N, K+1), uncertainty (N,) and distance (N,) [m] to the nearest sample: on the card's voxels.
    """

    coarse: dict[int, CoarseAnswer]
    meshes: DeliveredMeshes
    probability: np.ndarray
    uncertainty: np.ndarray
    distance: np.ndarray
    seconds: Seconds


def ask(case: Case, name: str, seed: int) -> Answers:
    """Fit a method on a case and take all its answers, with the time of each stage."""
    seconds: Seconds = {}
    with timed(seconds, "fit"):
        fitted = method(name).fit(case.view, case.rng(seed, "fit"))
    with timed(seconds, "mesh"):
        coarse = coarse_answers(fitted, case)
    with timed(seconds, "mesh_5mm"):
        meshes = delivered_meshes(fitted, case)
    points = case.card_voxels.points
    probability, uncertainty = fitted.predict(points)
    distance = distance_to_samples(points, fitted.samples)
    return Answers(coarse, meshes, probability, uncertainty, distance, seconds)


@contextmanager
def timed(seconds: Seconds, stage: str) -> Iterator[None]:
    """Add a stage's wall-clock and processor seconds."""
    watch = Stopwatch()
    yield
    seconds.update(watch.figures(stage))


def coarse_answers(fitted: FittedMap, case: Case) -> dict[int, CoarseAnswer]:
    """Each judged and observed object on a 15 mm grid over a 0.4 m cube around its true box."""
    found = {}
    for label in case.judged:
        index = case.index_of.get(label)
        if index is None:
            continue
        grid = coarse_grid(case, label)
        axes = [grid[:, 0, 0, 0], grid[0, :, 0, 1], grid[0, 0, :, 2]]
        probability = fitted.occupancy(axes, index)
        seen = case.observation.objects[index].points if fitted.keeps_seen else None
        found[label] = CoarseAnswer(probability > 0.5, surface_of(probability, axes, seen))
    return found


def coarse_grid(case: Case, label: int) -> np.ndarray:
    """The 15 mm grid (n, n, n, 3) [m] of V-PRISM's protocol around a true object."""
    return grid_around(case.meshes[label].bounds.mean(0), spacing=COARSE_SPACING)


def surface_of(
    probability: np.ndarray, axes: list[np.ndarray], seen: np.ndarray | None = None
) -> trimesh.Trimesh | None:
    """Closed mesh where P on a lattice of even spacing crosses 0.5, None where it never does.

    seen: points (N, 3) [m] the mesh is to keep, as meshes of the project do (MeshConfig.keep_seen).
    """
    from skimage.measure import marching_cubes

    spacing = axes[0][1] - axes[0][0]
    if seen is not None:
        corner = np.array([axis[0] for axis in axes])
        nodes = nodes_of_seen_cells(probability, corner, spacing, seen, 0.5, _probability(RULED_OUT))
        probability = probability.copy()
        probability[nodes] = _probability(SEEN_LOG_ODDS)
    if not (probability > 0.5).any():
        return None
    vertices, faces, _, _ = marching_cubes(np.pad(probability, 1), 0.5, gradient_direction="ascent")
    corner = np.array([axis[0] for axis in axes])
    return trimesh.Trimesh(corner + spacing * (vertices - 1), faces, process=False)


def _probability(log_odds: float) -> float:
    return float(1 / (1 + np.exp(-log_odds)))


def delivered_meshes(fitted: FittedMap, case: Case) -> DeliveredMeshes:
    """The mesh a method delivers of every observed object."""
    found = zip(case.observation.objects, fitted.meshes(case.view))
    return {item.label: surface for item, surface in found if surface is not None}
