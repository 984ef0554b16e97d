"""The figures: box plots, risk-coverage curves, reliability, time against the number of objects."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from mapping.files import temporary_beside
from tools.evaluation.statistics import CURVE_POINTS

COLOURS = {
    "contramap": "#1f6fd0",
    "contramap-paper": "#7fb2ee",
    "hilbert": "#3aa662",
    "bayesian-hilbert": "#9bd3ae",
    "vprism": "#e0662f",
    "vprism-dense": "#a8431b",
    "vprism-bound": "#f3b08f",
    "tsdf": "#7a7f87",
}
"""One colour a method in every figure."""
SIZE = (6.4, 4.0)
"""Inches."""
DPI = 150


def write_figures(results: list[dict[str, Any]], folder: Path) -> dict[str, Path]:
    """Draw all figures as PNG into a folder; returns title -> file."""
    folder.mkdir(parents=True, exist_ok=True)
    drawn = {
        "IoU of each object, 15 mm grid": (_boxes, {"metric": "iou", "label": "IoU"}),
        "Chamfer distance of each object, 15 mm grid": (
            _boxes,
            {"metric": "chamfer_mm", "label": "Chamfer distance [mm]"},
        ),
        "IoU of each object, 5 mm grid": (_boxes, {"metric": "iou_5mm", "label": "IoU"}),
        "Risk against coverage": (_risk, {}),
        "Reliability": (_reliability, {}),
        "Time against number of objects": (_times, {}),
    }
    names = ("iou", "chamfer", "iou_5mm", "risk_coverage", "reliability", "time")
    files = {}
    for name, (title, (draw, arguments)) in zip(names, drawn.items(), strict=True):
        files[title] = folder / f"{name}.png"
        _save(draw, files[title], _by_method(results), arguments)
    return files


def _by_method(results: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    found = defaultdict(list)
    for result in results:
        found[result["method"]].append(result)
    return dict(found)


def _save(draw, path: Path, results: dict[str, list[dict[str, Any]]], arguments: dict[str, Any]) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    style: dict[Any, Any] = {
        "font.size": 10,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
    }
    with plt.rc_context({**style, "grid.color": "#e6e8eb", "axes.axisbelow": True}):
        figure, axes = plt.subplots(figsize=SIZE, dpi=DPI, layout="constrained")
        draw(axes, results, **arguments)
        with temporary_beside(path) as partial:
            figure.savefig(partial, format="png")
        plt.close(figure)


def _boxes(axes, results: dict[str, list[dict[str, Any]]], metric: str, label: str) -> None:
    values = [
        [item[metric] for result in of for item in result["objects"] if item.get(metric) is not None]
        for of in results.values()
    ]
    boxes = axes.boxplot(
        values,
        orientation="horizontal",
        patch_artist=True,
        widths=0.6,
        medianprops={"color": "#1b1f24", "linewidth": 1.4},
        flierprops={"marker": ".", "markersize": 3, "markerfacecolor": "#8a9099", "markeredgecolor": "none"},
    )
    for box, name in zip(boxes["boxes"], results):
        box.set(facecolor=COLOURS.get(name, "#bbbbbb"), edgecolor="#1b1f24", linewidth=0.8)
    axes.set_yticks(range(1, len(results) + 1), list(results))
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.set_xlabel(label)
    axes.set_xlim(left=0)


def _risk(axes, results: dict[str, list[dict[str, Any]]]) -> None:
    coverage = np.linspace(0, 1, CURVE_POINTS)
    for name, of in results.items():
        mean = np.mean([result["curves"]["risk"] for result in of], axis=0)
        axes.plot(coverage, 100 * mean, color=COLOURS.get(name), label=name, linewidth=1.8)
    axes.set_xlabel("coverage: share of voxels answered, surest first")
    axes.set_ylabel("wrong answers [%]")
    axes.set_xlim(0, 1)
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False)


def _reliability(axes, results: dict[str, list[dict[str, Any]]]) -> None:
    axes.plot([0, 1], [0, 1], color="#8a9099", linewidth=1, linestyle="--")
    lowest = 1.0
    for name, of in results.items():
        bins = np.array([result["curves"]["reliability"] for result in of], float)  # (runs, bins, 3)
        weight = bins[:, :, 2]
        confidence, accuracy = ((bins[:, :, i] * weight).sum(0) / weight.sum(0) for i in (0, 1))
        lowest = min(lowest, float(confidence.min()), float(accuracy.min()))
        axes.plot(
            confidence,
            accuracy,
            color=COLOURS.get(name),
            marker="o",
            markersize=3.5,
            label=name,
            linewidth=1.4,
        )
    axes.set_xlabel("confidence of the most probable class")
    axes.set_ylabel("share of right answers")
    axes.set_xlim(lowest - 0.03, 1.01)
    axes.set_ylim(lowest - 0.03, 1.01)
    _legend_beside(axes)


def _times(axes, results: dict[str, list[dict[str, Any]]]) -> None:
    for name, of in results.items():
        seconds = defaultdict(list)
        for result in of:
            seconds[result["object_count"]].append(result["fit_cpu_s"] + result["mesh_cpu_s"])
        counts = sorted(seconds)
        colour = COLOURS.get(name)
        axes.plot(
            counts,
            [np.median(seconds[count]) for count in counts],
            color=colour,
            marker="o",
            markersize=4,
            label=name,
        )
        spread = np.array([np.percentile(seconds[count], [25, 75]) for count in counts])
        axes.fill_between(counts, spread[:, 0], spread[:, 1], color=colour, alpha=0.15, linewidth=0)
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("")
    axes.set_xlabel("objects")
    axes.set_ylabel("fit and mesh at 15 mm, processor [s]")
    axes.xaxis.get_major_locator().set_params(integer=True)
    _legend_beside(axes)


def _legend_beside(axes) -> None:
    """Where lines fill the axes, their names stand to the right of them."""
    axes.legend(frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
