"""The summary as tables of text: shapes, uncertainty, speed, comparisons, significance."""

from __future__ import annotations

from typing import Any

from tools.evaluation.against import CROWDED
from tools.evaluation.classes import CLASS_METRICS
from tools.evaluation.summary import COMPARED, LOWER_IS_BETTER
from tools.markdown import markdown_table

SHAPE_COLUMNS = {
    "iou": "IoU",
    "chamfer_mm": "Chamfer [mm]",
    "iou_5mm": "IoU 5 mm",
    "chamfer_5mm": "Chamfer 5 mm [mm]",
    "fscore_5mm": "F at 5 mm",
    "fscore_10mm": "F at 10 mm",
    "visible_mm": "visible [mm]",
    "hidden_mm": "hidden [mm]",
}
SURFACE_COLUMNS = {
    "agreement": "agreement, 3 mm",
    "early_rays": "early rays",
    "normal_deg": "normals [deg]",
    "handles": "handles",
    "handles_right": "handles right",
    "vessel_handles_right": "of vessels half seen",
    "parts": "parts",
    "creases_excess_per_m": "creases, more than true [1/m]",
    "wall_excess_mm": "walls too thick [mm]",
    "vessel_wall_mm": "of vessels, across [mm]",
    "iou_2_5mm": "IoU 2.5 mm",
}
CARD_COLUMNS = {
    "occlusion_auroc": "occlusion AUROC",
    "error_auroc": "error AUROC",
    "error_auroc_occluded": "error AUROC, occluded",
    "aurc": "AURC",
    "ause": "AUSE",
    "vertex_spearman": "vertex Spearman",
    "brier": "Brier",
    "ece": "ECE",
}
DIGITS = {"chamfer_mm": 1, "chamfer_5mm": 1, "visible_mm": 1, "hidden_mm": 1, "aurc": 4, "ause": 4, "ece": 4}
DIGITS |= {"normal_deg": 1, "handles": 2, "parts": 2, "creases_excess_per_m": 1}
DIGITS |= {"wall_excess_mm": 1, "vessel_wall_mm": 1}
"""Digits after the point, 3 for all others."""


def all_tables(summary: dict[str, Any]) -> list[str]:
    """Every table as markdown under its title, those without rows left out."""
    kinds = {
        "Shapes": shape_rows,
        "Missing objects": missing_rows,
        "Surfaces": surface_rows,
        "Uncertainty": card_rows,
        "Speed": speed_rows,
        "Against V-PRISM": against_rows,
        "Sturdy objects": sturdy_rows,
        "Classes of objects": class_rows,
        "Significance": paired_rows,
    }
    tables = {title: rows(summary) for title, rows in kinds.items()}
    return [
        f"### {title}\n\n{markdown_table(rows).rstrip()}" for title, rows in tables.items() if len(rows) > 1
    ]


def shape_rows(summary: dict[str, Any]) -> list[list[str]]:
    """Header and one row a method: mean ± spread over scenes (± over seeds when there are several)."""
    header = ["method", "scenes", "objects", "missing", *SHAPE_COLUMNS.values()]
    rows = [
        [name, *(str(entry[key]) for key in ("scenes", "objects", "missing")), *_cells(entry, SHAPE_COLUMNS)]
        for name, entry in summary["methods"].items()
    ]
    return [header, *rows]


def missing_rows(summary: dict[str, Any]) -> list[list[str]]:
    """Header and one row an object that a method has no mesh of, on either grid, with the seeds of it."""
    rows = [["object", "scene", "method", "no mesh at 15 mm, seeds", "no mesh at 5 mm, seeds"]]
    for found in summary["missing_objects"]:
        seeds = [", ".join(map(str, found[key])) for key in ("seeds", "seeds_5mm")]
        rows.append([f"{found['label']} {found['name']}", found["scene"], found["method"], *seeds])
    return rows


def failure_rows(summary: dict[str, Any]) -> list[list[str]]:
    """Header and one row a run that failed."""
    keys = ["scene", "seed", "method", "error"]
    return [keys, *([str(failure[key]) for key in keys] for failure in summary.get("failures", ()))]


def surface_rows(summary: dict[str, Any]) -> list[list[str]]:
    """Header and one row a method: what the surface card says of delivered meshes."""
    rows = [[name, *_cells(entry, SURFACE_COLUMNS)] for name, entry in summary["methods"].items()]
    return [["method", *SURFACE_COLUMNS.values()], *(row for row in rows if any(row[1:]))]


def card_rows(summary: dict[str, Any]) -> list[list[str]]:
    """Header, one row a method, and after each the nulls judged on that method's answers."""
    rows = [["uncertainty of", *CARD_COLUMNS.values()]]
    for name, entry in summary["methods"].items():
        rows.append([name, *_cells(entry, CARD_COLUMNS)])
        for null, scores in entry["nulls"].items():
            what = "distance to samples" if null == "distance" else "V-PRISM's entropy"
            cells = [_number(metric, scores.get(metric)) for metric in CARD_COLUMNS]
            rows.append([f"  {what}, on {name}'s answers", *cells])
    return rows


def speed_rows(summary: dict[str, Any]) -> list[list[str]]:
    """Header and one row a method: median seconds of each stage, and processor seconds."""
    rows = [
        [
            "method",
            "fit [s]",
            "mesh 15 mm [s]",
            "mesh 5 mm [s]",
            "fit + mesh 15 mm [s]",
            "processor, fit + mesh 15 mm [s]",
        ]
    ]
    for name, entry in summary["methods"].items():
        stages = [entry[key] for key in ("fit_s", "mesh_s", "mesh_5mm_s")]
        totals = [entry["fit_s"] + entry["mesh_s"], entry["fit_cpu_s"] + entry["mesh_cpu_s"]]
        rows.append([name, *(f"{value:.3f}" for value in (*stages, *totals))])
    return rows


def against_rows(summary: dict[str, Any]) -> list[list[str]]:
    """Header and one row a method and V-PRISM formulation, on the scenes both were run on."""
    rows = [
        [
            "method",
            "against",
            "scenes",
            "objects",
            "IoU gain",
            "Chamfer ratio",
            "IoU gain 5 mm",
            "Chamfer ratio 5 mm",
            "AURC ratio",
            "times faster",
            f"times faster, {CROWDED} objects or more",
        ]
    ]
    for row in summary["against"]:
        accuracy = [
            _signed(row["iou_gain"]),
            _number("", row["chamfer_ratio"]),
            _signed(row["iou_5mm_gain"]),
            _number("", row["chamfer_5mm_ratio"]),
            _number("", row["aurc_ratio"]),
        ]
        crowded = "" if row["faster_crowded"] is None else f"{row['faster_crowded']:.1f} x"
        if crowded:
            crowded += f" ({row['crowded_scenes']} scenes)"
        speed = [f"{row['faster']:.1f} x", crowded]
        counts = [str(row["scenes"]), str(row["objects"])]
        rows.append([row["method"], row["reference"], *counts, *accuracy, *speed])
    return rows


def sturdy_rows(summary: dict[str, Any]) -> list[list[str]]:
    """Header and one row a method: means over sturdy objects."""
    rows = [["method", "sturdy objects", *(SHAPE_COLUMNS[metric] for metric in CLASS_METRICS)]]
    for name, entry in summary["sturdy"].items():
        cells = [_number(metric, entry[metric]) for metric in CLASS_METRICS]
        rows.append([name, str(entry["objects"]), *cells])
    return rows


def class_rows(summary: dict[str, Any]) -> list[list[str]]:
    """Header and one row a class: IoU of both methods and which is better, Chamfer distances at 5 mm."""
    a, b = COMPARED
    header = ["class", "objects", "sturdy", f"IoU {a}", f"IoU {b}", "difference", "better"]
    rows = [[*header, f"Chamfer 5 mm {a} [mm]", f"Chamfer 5 mm {b} [mm]"]]
    for row in summary["classes"]:
        numbers = [_number("iou", row[a]["iou"]), _number("iou", row[b]["iou"]), _signed(row["difference"])]
        fine = [_number("chamfer_5mm", row[name]["chamfer_5mm"]) for name in COMPARED]
        better = a if row["difference"] > 0 else b if row["difference"] < 0 else "neither"
        count = [str(row["objects"]), "yes" if row["sturdy"] else ""]
        rows.append([row["class"], *count, *numbers, better, *fine])
    return rows


def paired_rows(summary: dict[str, Any]) -> list[list[str]]:
    """Header and one row a test."""
    rows = [["metric", "better", "worse", "scenes", "mean difference", "Wilcoxon p"]]
    for test in summary["paired"]:
        first_wins = (test["difference"] < 0) == (test["metric"] in LOWER_IS_BETTER)
        better, worse = (test["a"], test["b"]) if first_wins else (test["b"], test["a"])
        p = "< 0.0001" if test["p"] < 1e-4 else f"{test['p']:.4f}"
        size = _number(test["metric"], abs(test["difference"]))
        rows.append([test["metric"], better, worse, str(test["scenes"]), size, p])
    return rows


def _cells(entry: dict[str, Any], columns: dict[str, str]) -> list[str]:
    cells = []
    for metric in columns:
        found = entry.get(metric)
        text = _number(metric, found["mean"] if found else None)
        if found:
            text += f" ± {_number(metric, found['std'])}"
            if found["std_seeds"]:
                text += f" ({_number(metric, found['std_seeds'])})"
        cells.append(text)
    return cells


def _number(metric: str, value: float | None) -> str:
    return "" if value is None else f"{value:.{DIGITS.get(metric, 3)}f}"


def _signed(value: float | None) -> str:
    return "" if value is None else f"{value:+.3f}"
