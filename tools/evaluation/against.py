"""Every method against V-PRISM on exactly the scenes that both were run on: accuracy, uncertainty, speed."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import numpy as np

from tools.evaluation.classes import objects_of

REFERENCES = ("vprism", "vprism-dense")
"""V-PRISM with truncated features, and as published."""
CROWDED = 7
"""Scenes with at least this many objects are crowded."""


def against(results: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row a reference and other method that share scenes; ratios are method over reference.

    iou_gain, iou_5mm_gain: mean differences over shared objects. chamfer_ratio, chamfer_5mm_ratio: of means
    over objects that both have. aurc_ratio: of means over shared scenes. faster, faster_crowded: median over
    scenes (over crowded ones) of how many times less processor time fit and 15 mm meshes took; None without
    such scenes.
    """
    methods = dict.fromkeys(result["method"] for result in results)
    rows = [
        _row(results, method, reference)
        for reference in REFERENCES
        for method in methods
        if reference in methods and method != reference
    ]
    return [row for row in rows if row["scenes"]]


def _row(results: list[dict[str, Any]], method: str, reference: str) -> dict[str, Any]:
    by_scene: dict[str, dict[str, list[dict[str, Any]]]] = defaultdict(lambda: defaultdict(list))
    for result in results:
        by_scene[result["scene"]][result["method"]].append(result)
    shared = [runs for runs in by_scene.values() if runs.get(method) and runs.get(reference)]
    speed = [_seconds(runs[reference]) / _seconds(runs[method]) for runs in shared]
    crowded = [runs[method][0]["object_count"] >= CROWDED for runs in shared]
    mine, theirs = objects_of(results, method), objects_of(results, reference)
    pairs = [(mine[key], theirs[key]) for key in mine.keys() & theirs.keys()]
    risks = [
        np.mean([np.mean([run["card"]["aurc"] for run in runs[name]]) for runs in shared])
        for name in (method, reference)
        if shared
    ]
    fast = [ratio for ratio, many in zip(speed, crowded) if many]
    return {
        "method": method,
        "reference": reference,
        "scenes": len(shared),
        "crowded_scenes": len(fast),
        "objects": len(pairs),
        "iou_gain": _gain(pairs, "iou"),
        "chamfer_ratio": _ratio(pairs, "chamfer_mm"),
        "iou_5mm_gain": _gain(pairs, "iou_5mm"),
        "chamfer_5mm_ratio": _ratio(pairs, "chamfer_5mm"),
        "aurc_ratio": float(risks[0] / risks[1]) if shared and risks[1] else None,
        "faster": float(np.median(speed)) if speed else None,
        "faster_crowded": float(np.median(fast)) if fast else None,
    }


def _seconds(runs: list[dict[str, Any]]) -> float:
    return float(np.mean([run["fit_cpu_s"] + run["mesh_cpu_s"] for run in runs]))


def _gain(pairs: list[tuple[dict[str, Any], dict[str, Any]]], metric: str) -> float | None:
    return float(np.mean([a[metric] - b[metric] for a, b in pairs])) if pairs else None


def _ratio(pairs: list[tuple[dict[str, Any], dict[str, Any]]], metric: str) -> float | None:
    both = [(a[metric], b[metric]) for a, b in pairs if a[metric] is not None and b[metric] is not None]
    return float(np.divide(*np.mean(both, axis=0))) if both else None
