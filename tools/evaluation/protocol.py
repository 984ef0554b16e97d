"""Shape metrics per object: V-PRISM's protocol on a 15 mm grid, and a fine one on the delivered meshes."""

from __future__ import annotations

from time import perf_counter
from typing import Any

import numpy as np
import trimesh

from reconstruction.meshing import MeshConfig, extract_mesh
from reconstruction.metrics import (
    SURFACE_SAMPLES,
    chamfer,
    chamfer_of_points,
    distance_to_surface,
    fscore_of_points,
    grid_around,
    hidden_and_visible_error,
    inside,
    iou,
    sample_surface,
)
from reconstruction.scene import object_space as object_boxes
from tools.evaluation.case import Case
from tools.evaluation.methods import FittedMap
from tools.evaluation.statistics import spearman

COARSE_SPACING = 0.015
"""Grid of V-PRISM's protocol [m]."""
FINE_SPACING = 0.005
"""Grid of the fine protocol [m]."""


def coarse_protocol(
    fitted: FittedMap, case: Case, rng: np.random.Generator
) -> tuple[dict[int, dict[str, Any]], float]:
    """V-PRISM's protocol: {label: {iou, chamfer_mm}} and the seconds that evaluation and meshing took.

    A 15 mm grid over a 0.4 m cube around the true box; occupied where P(object) > 0.5. An object without
    prediction has IoU 0 and Chamfer None.
    """
    found: dict[int, dict[str, Any]] = {}
    seconds = 0.0
    for label in case.judged:
        true, index = case.meshes[label], case.index_of.get(label)
        grid = grid_around(true.bounds.mean(0), spacing=COARSE_SPACING)
        found[label] = {"iou": 0.0, "chamfer_mm": None}
        if index is None:
            continue
        axes = [grid[:, 0, 0, 0], grid[0, :, 0, 1], grid[0, 0, :, 2]]
        start = perf_counter()
        probability = fitted.occupancy(axes, index)
        mesh = surface_of(probability, axes)
        seconds += perf_counter() - start
        if mesh is not None:
            found[label]["iou"] = iou(probability > 0.5, inside(true, grid))
            found[label]["chamfer_mm"] = 1e3 * chamfer(mesh, true, rng)
    return found, seconds


def surface_of(probability: np.ndarray, axes: list[np.ndarray]) -> trimesh.Trimesh | None:
    """Closed mesh where P on a lattice of even spacing crosses 0.5, None where it never does."""
    from skimage.measure import marching_cubes

    if not (probability > 0.5).any():
        return None
    spacing = axes[0][1] - axes[0][0]
    vertices, faces, _, _ = marching_cubes(np.pad(probability, 1), 0.5, gradient_direction="ascent")
    corner = np.array([axis[0] for axis in axes])
    return trimesh.Trimesh(corner + spacing * (vertices - 1), faces, process=False)


def delivered_meshes(
    fitted: FittedMap, case: Case, config: MeshConfig
) -> tuple[dict[int, tuple[trimesh.Trimesh, np.ndarray]], float]:
    """The project's own extraction at 5 mm: {label: (mesh, uncertainty (V,))} and the seconds it took."""
    lows, highs = object_boxes(case.observation, config.margin)
    start = perf_counter()
    field = fitted.field(lows, highs, FINE_SPACING)
    meshes = {}
    for index, item in enumerate(case.observation.objects):
        extracted = extract_mesh(field, index, lows[index], highs[index], config)
        if extracted is not None:
            meshes[item.label] = extracted
    return meshes, perf_counter() - start


def fine_protocol(
    meshes: dict[int, tuple[trimesh.Trimesh, np.ndarray]], case: Case, rng: np.random.Generator
) -> dict[int, dict[str, Any]]:
    """{label: metrics} of delivered meshes: IoU on a 5 mm grid, Chamfer, F-score at 5 and 10 mm, distance of
    the visible and hidden true surface from the mesh [mm], and how well vertex uncertainty ranks errors."""
    found: dict[int, dict[str, Any]] = {}
    for label in case.judged:
        found[label] = {"iou_5mm": 0.0, "fscore_5mm": 0.0, "fscore_10mm": 0.0}
        if label not in meshes:
            continue
        mesh, uncertainty = meshes[label]
        true = case.meshes[label]
        a, b = (sample_surface(m, SURFACE_SAMPLES, rng) for m in (mesh, true))
        seen = case.observation.objects[case.index_of[label]].points
        parts = hidden_and_visible_error(mesh, true, seen, rng)
        found[label] = {
            "iou_5mm": mesh_iou(mesh, true, FINE_SPACING),
            "chamfer_5mm": 1e3 * chamfer_of_points(a, b),
            "fscore_5mm": fscore_of_points(a, b, 0.005),
            "fscore_10mm": fscore_of_points(a, b, 0.010),
            "visible_mm": 1e3 * parts["visible"],
            "hidden_mm": 1e3 * parts["hidden"],
            "vertex_spearman": spearman(uncertainty, distance_to_surface(true, mesh.vertices)),
        }
    return found


def mesh_iou(a: trimesh.Trimesh, b: trimesh.Trimesh, spacing: float) -> float:
    """IoU of the insides of two closed meshes, counted on a grid of `spacing` [m] over both of them."""
    low = np.minimum(a.bounds[0], b.bounds[0])
    axes = [np.arange(o + spacing / 2, h, spacing) for o, h in zip(low, np.maximum(a.bounds[1], b.bounds[1]))]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    return iou(inside(a, grid), inside(b, grid))
