"""One self-contained HTML file: sortable tables, figures and the gallery, images embedded."""

from __future__ import annotations

import base64
from html import escape
from pathlib import Path
from typing import Any

from mapping.files import write_atomically
from tools.evaluation.table import (
    against_rows,
    card_rows,
    class_rows,
    paired_rows,
    shape_rows,
    speed_rows,
    sturdy_rows,
    surface_rows,
)

STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; color: #1b1f24; background: #fff;
  max-width: 1480px; margin: 0 auto; padding: 28px 24px 80px; }
h1 { font-size: 26px; margin: 0 0 4px; } h2 { font-size: 19px; margin: 40px 0 8px; }
p { max-width: 78ch; margin: 6px 0 12px; color: #3c434c; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: 12.5px; white-space: nowrap;
  font-variant-numeric: tabular-nums; }
th, td { padding: 5px 10px 5px 0; text-align: right; border-bottom: 1px solid #e6e8eb; }
th:first-child, td:first-child { text-align: left; white-space: pre; }
th { cursor: pointer; border-bottom: 2px solid #1b1f24; user-select: none; vertical-align: bottom; }
th:hover { color: #1f6fd0; } th[data-order]::after { content: " \\25B2"; font-size: 9px; }
th[data-order="-1"]::after { content: " \\25BC"; }
tr.null td { color: #6a727c; }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(420px, 1fr)); gap: 20px 28px; }
figure { margin: 0; } figcaption { font-weight: 600; margin-bottom: 4px; } img { width: 100%; height: auto; }
"""
SCRIPT = """
for (const header of document.querySelectorAll("th")) header.onclick = () => {
  const table = header.closest("table"), body = table.tBodies[0], column = header.cellIndex;
  const order = header.dataset.order === "1" ? -1 : 1;
  for (const other of table.querySelectorAll("th")) delete other.dataset.order;
  header.dataset.order = order;
  const value = row => {
    const text = row.cells[column].textContent.replace("< ", "").trim();
    const number = parseFloat(text);
    return Number.isNaN(number) ? (text === "" ? Infinity : text.toLowerCase()) : number;
  };
  const compare = (a, b) =>
    typeof a !== typeof b ? (typeof a === "number" ? -1 : 1) : a < b ? -1 : a > b ? 1 : 0;
  [...body.rows].sort((a, b) => order * compare(value(a), value(b))).forEach(row => body.append(row));
};
"""
SHAPES = (
    "Mean over objects ± standard deviation over scenes (standard deviation over seeds). IoU and Chamfer: "
    "V-PRISM's protocol on a 15 mm grid; there even the true shapes score a Chamfer distance of about 8 mm. "
    "The columns at 5 mm judge delivered meshes; visible and hidden: mean distance of the true surface from "
    "the mesh, within 1 cm of what the camera saw and elsewhere. Missing: objects without any prediction, "
    "which count as IoU 0 and have no Chamfer distance."
)
SURFACES = (
    "Delivered meshes against the frame as it was given and the true shapes. Agreement: share of labelled, "
    "measured pixels whose ray first meets its object's mesh within 3 mm of the depth; early rays: rays a "
    "mesh stops more than 6 mm too early, per labelled pixel. Normals: angle to the true normal within 4 mm "
    "of seen points. Handles: genus of the mesh; right: the true mesh has as many. Walls: along rays on "
    "which the true object is at most 15 mm thick."
)
CARD = (
    "On 1 cm voxels above the table within 15 cm of true objects. Occlusion AUROC: does it rank hidden space "
    "above seen space? Error AUROC: does it rank wrong answers above right ones? AURC: mean error rate over "
    "all coverages, AUSE: its excess over a perfect ranking. Grey rows: a null uncertainty, judged on the "
    "same answers."
)
SPEED = (
    "Medians over scenes and seeds. Fit: samples, features and weights; meshes of all objects. Processor "
    "seconds hardly depend on what else the machine does."
)
AGAINST = (
    "On the scenes both were run on: mean gain of IoU, ratios of mean Chamfer distances (objects both have) "
    "and of mean AURC; below 1 is better. Times faster: median ratio of processor seconds of fit and 15 mm "
    "meshes. vprism drops features below 1e-7, vprism-dense keeps all as published."
)
STURDY = "Cans, boxes, bottles, fruit and the power drill: thick enough for a grid of 5 to 15 mm."
CLASSES = (
    "Objects both methods were judged on, seeds averaged, worst first; variants of a YCB number are one "
    "class."
)
PAIRED = "Differences of scene means, seeds averaged, on scenes both methods were run on."


def write_report(summary: dict[str, Any], figures: dict[str, Path], gallery: Path | None, path: Path) -> None:
    """Write report.html from a summary, figures by title and the gallery's picture."""
    seeds = ", ".join(str(seed) for seed in summary["seeds"])
    threads = summary["threads"]
    parts = [
        "<h1>Evaluation</h1>",
        f"<p>{summary['scenes']} scenes, seeds {seeds}, {threads} thread{'s' * (threads != 1)} a job. "
        "Click a column to sort by it.</p>",
        _section("Shapes", SHAPES, _table(shape_rows(summary))),
        _section("Surfaces", SURFACES, _table(surface_rows(summary))),
        _section("Uncertainty", CARD, _table(card_rows(summary))),
        _section("Speed", SPEED, _table(speed_rows(summary))),
    ]
    if summary["against"]:
        parts.append(_section("Against V-PRISM", AGAINST, _table(against_rows(summary))))
    parts.append(_section("Figures", "", _figures(figures)))
    if gallery is not None:
        caption = "Slices: blue is sure, yellow is uncertain; true outlines white, predicted ones black."
        parts.append(_section("Gallery", caption, _image(gallery, "gallery")))
    if summary["sturdy"]:
        parts.append(_section("Sturdy objects", STURDY, _table(sturdy_rows(summary))))
    if summary["classes"]:
        parts.append(_section("Classes of objects", CLASSES, _table(class_rows(summary))))
    parts.append(_section("Significance", PAIRED, _table(paired_rows(summary))))
    if summary.get("failures"):
        rows = [["scene", "seed", "method", "error"], *([*f.values()] for f in summary["failures"])]
        parts.append(_section("Failures", "", _table(rows)))
    head = (
        '<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>Evaluation</title>'
    )
    page = f"<!doctype html><html lang=en><head>{head}<style>{STYLE}</style></head><body>"
    page += "\n".join(parts) + f"<script>{SCRIPT}</script></body></html>\n"
    write_atomically(path, page.encode())


def _section(title: str, text: str, content: str) -> str:
    return f"<h2>{escape(title)}</h2><p>{escape(text)}</p>{content}"


def _table(rows: list[list[str]]) -> str:
    head = "".join(f"<th>{escape(cell)}</th>" for cell in rows[0])
    body = ""
    for row in rows[1:]:
        kind = ' class="null"' if row[0].startswith("  ") else ""
        body += f"<tr{kind}>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>"
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _figures(figures: dict[str, Path]) -> str:
    shown = [
        f"<figure><figcaption>{escape(title)}</figcaption>{_image(path, title)}</figure>"
        for title, path in figures.items()
    ]
    return f'<div class="figures">{"".join(shown)}</div>'


def _image(path: Path, alternative: str) -> str:
    data = base64.b64encode(path.read_bytes()).decode()
    return f'<img src="data:image/png;base64,{data}" alt="{escape(alternative)}">'
