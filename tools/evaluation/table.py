"""The summary as tables of text: shapes, uncertainty, speed, significance."""

from __future__ import annotations

from typing import Any

from tools.evaluation.summary import LOWER_IS_BETTER

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
"""Digits after the point, 3 for all others."""


def shape_rows(summary: dict[str, Any]) -> list[list[str]]:
    """Header and one row a method: mean ± spread over scenes (± over seeds when there are several)."""
    header = ["method", "scenes", "objects", "missing", *SHAPE_COLUMNS.values()]
    rows = [
        [name, *(str(entry[key]) for key in ("scenes", "objects", "missing")), *_cells(entry, SHAPE_COLUMNS)]
        for name, entry in summary["methods"].items()
    ]
    return [header, *rows]


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
    """Header and one row a method: median seconds, and how many times faster than V-PRISM it is."""
    slow = summary["methods"].get("vprism")
    rows = [
        ["method", "fit [s]", "mesh 15 mm [s]", "mesh 5 mm [s]", "fit + mesh 15 mm [s]", "against V-PRISM"]
    ]
    for name, entry in summary["methods"].items():
        total = entry["fit_s"] + entry["mesh_s"]
        ratio = f"{(slow['fit_s'] + slow['mesh_s']) / total:.1f} x" if slow else ""
        times = [f"{entry[key]:.3f}" for key in ("fit_s", "mesh_s", "mesh_5mm_s")]
        rows.append([name, *times, f"{total:.3f}", ratio])
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


def markdown(rows: list[list[str]]) -> str:
    """A markdown table; the first row is its header."""
    lines = [" | ".join(row) for row in rows]
    rule = " | ".join(["---"] * len(rows[0]))
    return "\n".join(f"| {line} |" for line in [lines[0], rule, *lines[1:]])


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
