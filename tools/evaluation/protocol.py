"""Shape metrics per object: V-PRISM's protocol on a 15 mm grid, and a fine one on the delivered meshes."""

from __future__ import annotations

from typing import Any

import numpy as np

from reconstruction.metrics import (
    SURFACE_SAMPLES,
    chamfer,
    chamfer_of_distances,
    fscore_of_distances,
    hidden_and_visible_error,
    iou,
    mesh_iou,
    mutual_distances,
    sample_surface,
)
from reconstruction.solid import Solid
from tools.evaluation.answers import FINE_SPACING, CoarseAnswer, DeliveredMeshes, coarse_grid
from tools.evaluation.case import Case
from tools.evaluation.statistics import spearman
from tools.evaluation.surface_card import FINEST_SPACING, agreements, surface_card

ZERO_WHEN_MISSING = ("iou_5mm", "iou_2_5mm", "fscore_5mm", "fscore_10mm", "agreement", "early_rays")
"""Metrics of an object that got no mesh; the others are missing."""


def coarse_protocol(
    answers: dict[int, CoarseAnswer], case: Case, rng: np.random.Generator
) -> dict[int, dict[str, Any]]:
    """V-PRISM's protocol: {label: {iou, chamfer_mm}}; occupied is where P(object) > 0.5.

    An object that occupies no node has IoU 0, even where its true shape falls between the nodes too; one
    without a mesh has Chamfer None.
    """
    found: dict[int, dict[str, Any]] = {}
    for label in case.judged:
        found[label] = {"iou": 0.0, "chamfer_mm": None}
        answer = answers.get(label)
        if answer is not None and answer.mesh is not None:
            true = case.solids[label]
            if answer.occupied.any():
                found[label]["iou"] = iou(answer.occupied, true.inside(coarse_grid(case, label)))
            found[label]["chamfer_mm"] = 1e3 * chamfer(answer.mesh, true.mesh, rng)
    return found


def fine_protocol(meshes: DeliveredMeshes, case: Case, rng: np.random.Generator) -> dict[int, dict[str, Any]]:
    """{label: metrics} of delivered meshes: IoU on a 5 mm grid, Chamfer, F-score at 5 and 10 mm, distance of
    the visible and hidden true surface from the mesh [mm], how well vertex uncertainty ranks errors, and the
    surface card. An object without a mesh agrees with no ray."""
    found: dict[int, dict[str, Any]] = {}
    agreed = agreements({label: surface.mesh for label, surface in meshes.items()}, case)
    for label in case.judged:
        found[label] = dict.fromkeys(ZERO_WHEN_MISSING, 0.0)
        if label not in meshes:
            continue
        mesh, uncertainty = meshes[label].mesh, meshes[label].uncertainty
        predicted, true = Solid(mesh), case.solids[label]
        a, b = (sample_surface(m, SURFACE_SAMPLES, rng) for m in (mesh, true.mesh))
        distances = mutual_distances(a, b)
        seen = case.observation.objects[case.index_of[label]].points
        parts = hidden_and_visible_error(predicted, true.mesh, seen, rng)
        found[label] = {
            "iou_5mm": mesh_iou(predicted, true, FINE_SPACING),
            "chamfer_5mm": 1e3 * chamfer_of_distances(distances),
            "fscore_5mm": fscore_of_distances(distances, 0.005),
            "fscore_10mm": fscore_of_distances(distances, 0.010),
            "visible_mm": 1e3 * parts["visible"],
            "hidden_mm": 1e3 * parts["hidden"],
            "vertex_spearman": spearman(uncertainty, true.distance(mesh.vertices)),
            "agreement": agreed[label].agreement,
            "early_rays": agreed[label].early_rays,
            "iou_2_5mm": mesh_iou(predicted, true, FINEST_SPACING),
            **surface_card(mesh, predicted, true, seen, case.space.origin, rng),
        }
    return found
