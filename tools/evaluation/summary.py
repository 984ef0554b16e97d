"""From kept results to one table: means, spreads over scenes and seeds, and paired significance."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mapping.errors import DataError
from tools.evaluation.against import against
from tools.evaluation.classes import CLASS_METRICS, class_comparison, sturdy_summary

OBJECT_METRICS = (
    "iou",
    "chamfer_mm",
    "iou_5mm",
    "chamfer_5mm",
    "fscore_5mm",
    "fscore_10mm",
    "visible_mm",
    "hidden_mm",
    "vertex_spearman",
    "agreement",
    "early_rays",
    "normal_deg",
    "handles",
    "handles_right",
    "vessel_handles_right",
    "parts",
    "creases_excess_per_m",
    "wall_excess_mm",
    "vessel_wall_mm",
    "iou_2_5mm",
)
"""Metrics of single objects: a scene's value is the mean over its objects that have one."""
CARD_METRICS = (
    "occlusion_auroc",
    "error_auroc",
    "error_auroc_occluded",
    "aurc",
    "ause",
    "brier",
    "ece",
    "error_rate",
)
"""Metrics of whole scenes."""
STAGES = ("fit", "mesh", "mesh_5mm")
TIMES = tuple(f"{stage}{kind}" for kind in ("_s", "_cpu_s") for stage in STAGES)
"""Wall-clock and processor seconds; the summary gives their median."""
COMPARED = ("contramap", "vprism")
"""The methods that are compared class by class."""
LOWER_IS_BETTER = frozenset(
    {
        "chamfer_mm",
        "chamfer_5mm",
        "visible_mm",
        "hidden_mm",
        "aurc",
        "ause",
        "brier",
        "ece",
        "error_rate",
        "early_rays",
        "normal_deg",
        "handles",
        "creases_excess_per_m",
        "wall_excess_mm",
        "vessel_wall_mm",
        *TIMES,
    }
)


def read_results(files: Sequence[Path]) -> list[dict[str, Any]]:
    """The kept results in the order of the files. Raises DataError for a broken one."""
    results = []
    for path in files:
        try:
            results.append(json.loads(path.read_text()))
        except ValueError as error:
            raise DataError(f"{path}: broken result ({error}); delete it and run again") from error
    return results


def json_lines(results: list[dict[str, Any]]) -> str:
    """One short line a result, rounded: each object's IoU and Chamfer distances, the scene's other values.

    No curves and no means of what is listed by object: 1,100 results of six objects each stay below 1 MB.
    """
    lines = []
    for result in results:
        values = {
            key: float(f"{value:.3g}" if key in TIMES else f"{value:.4g}")
            for key, value in scene_values(result).items()
            if key not in CLASS_METRICS
        }
        per_object = {
            metric: [item.get(metric) and float(f"{item[metric]:.3g}") for item in result["objects"]]
            for metric in CLASS_METRICS
        }
        head = {key: result[key] for key in ("scene", "method", "seed", "object_count")}
        lines.append(json.dumps({**head, **values, "objects": per_object}, separators=(",", ":")))
    return "\n".join(lines) + "\n"


def scene_values(result: dict[str, Any]) -> dict[str, float]:
    """One number a metric for one result; metrics without any value are left out."""
    values: dict[str, float] = {}
    for metric in OBJECT_METRICS:
        given = [item[metric] for item in result["objects"] if item.get(metric) is not None]
        if given:
            values[metric] = float(np.mean(given))
    values |= {key: result["card"][key] for key in CARD_METRICS if result["card"].get(key) is not None}
    values |= {key: result[key] for key in TIMES}
    return values


def summarise(results: list[dict[str, Any]]) -> dict[str, Any]:
    """{scenes, seeds, methods: {name: {metric: {mean, std, std_seeds}, missing, fit_s, mesh_s, ...}},
    missing_objects, paired, against, sturdy, classes}; the last five as their functions say.

    mean: over objects for shapes and over scenes for the card, of all seeds; std: over scenes of their means
    over seeds; std_seeds: over seeds of their means over scenes. Times are medians.
    """
    by_method: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for result in results:
        by_method[result["method"]].append(result)
    return {
        "scenes": len({result["scene"] for result in results}),
        "seeds": sorted({result["seed"] for result in results}),
        "methods": {name: _method(items) for name, items in by_method.items()},
        "missing_objects": missing_objects(results),
        "paired": paired_tests(results),
        "against": against(results),
        "sturdy": sturdy_summary(results),
        "classes": _classes(results),
    }


def missing_objects(results: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Objects without a mesh: {method, scene, label, name, seeds, seeds_5mm}, the seeds without one on the
    protocol's grid of 15 mm and on that of delivered meshes."""
    found: dict[tuple[str, str, int], dict[str, Any]] = {}
    for result in results:
        for item in result["objects"]:
            for metric, seeds in (("chamfer_mm", "seeds"), ("chamfer_5mm", "seeds_5mm")):
                if item.get(metric) is None:
                    head = {key: result[key] for key in ("method", "scene")}
                    head |= {"label": item["label"], "name": item["name"], "seeds": [], "seeds_5mm": []}
                    key = (result["method"], result["scene"], item["label"])
                    found.setdefault(key, head)[seeds].append(result["seed"])
    return list(found.values())


def _classes(results: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """COMPARED class by class; empty when one of them was not run."""
    methods = {result["method"] for result in results}
    return class_comparison(results, *COMPARED) if set(COMPARED) <= methods else []


def _method(results: list[dict[str, Any]]) -> dict[str, Any]:
    objects = [item for result in results for item in result["objects"]]
    values = [(result["scene"], result["seed"], scene_values(result)) for result in results]
    entry: dict[str, Any] = {
        "scenes": len({result["scene"] for result in results}),
        "objects": len(objects),
        "missing": sum(item.get("chamfer_mm") is None for item in objects),
        "missing_5mm": sum(item.get("chamfer_5mm") is None for item in objects),
    }
    for metric in (*OBJECT_METRICS, *CARD_METRICS):
        if metric in OBJECT_METRICS:
            pool = [item[metric] for item in objects if item.get(metric) is not None]
        else:
            pool = [found[metric] for *_, found in values if metric in found]
        if pool:
            entry[metric] = {
                "mean": float(np.mean(pool)),
                "std": _spread([(scene, found) for scene, _, found in values], metric),
                "std_seeds": _spread([(seed, found) for _, seed, found in values], metric),
            }
    for metric in TIMES:
        entry[metric] = float(np.median([found[metric] for *_, found in values]))
    entry["nulls"] = _nulls(results)
    return entry


def _spread(values: list[tuple[Any, dict[str, float]]], metric: str) -> float:
    """Standard deviation over groups of their means."""
    groups = defaultdict(list)
    for key, found in values:
        if metric in found:
            groups[key].append(found[metric])
    means = [np.mean(group) for group in groups.values()]
    return float(np.std(means, ddof=1)) if len(means) > 1 else 0.0


def _nulls(results: list[dict[str, Any]]) -> dict[str, dict[str, float]]:
    pooled: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for result in results:
        for null, scores in result["nulls"].items():
            for metric, value in scores.items():
                if value is not None:
                    pooled[null][metric].append(value)
    return {null: {m: float(np.mean(v)) for m, v in scores.items()} for null, scores in pooled.items()}


def paired_tests(results: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Wilcoxon signed-rank tests between methods over scenes both were run on, seeds averaged.

    Each {metric, a, b, scenes, difference (mean of a - b), p}; pairs with no difference at all have p = 1.
    """
    from scipy.stats import wilcoxon

    table: dict[str, dict[str, dict[str, list[float]]]] = defaultdict(lambda: defaultdict(dict))
    for result in results:
        for metric, value in scene_values(result).items():
            table[metric][result["method"]].setdefault(result["scene"], []).append(value)
    tests = []
    for metric in ("iou", "chamfer_mm", "iou_5mm", "chamfer_5mm", "occlusion_auroc", "error_auroc", "aurc"):
        names = list(table[metric])
        for i, a in enumerate(names):
            for b in names[i + 1 :]:
                common = sorted(set(table[metric][a]) & set(table[metric][b]))
                if len(common) < 2:
                    continue
                x, y = (np.array([np.mean(table[metric][n][s]) for s in common]) for n in (a, b))
                p = float(wilcoxon(x, y).pvalue) if (x != y).any() else 1.0
                difference = float((x - y).mean())
                tests.append(
                    {
                        "metric": metric,
                        "a": a,
                        "b": b,
                        "scenes": len(common),
                        "difference": difference,
                        "p": p,
                    }
                )
    return tests
