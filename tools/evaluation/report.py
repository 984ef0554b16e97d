"""One self-contained HTML file: sortable tables, figures and the gallery, images embedded."""

from __future__ import annotations

import base64
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mapping.files import write_atomically
from tools.evaluation.table import (
    against_rows,
    card_rows,
    class_rows,
    failure_rows,
    missing_rows,
    paired_rows,
    shape_rows,
    speed_rows,
    sturdy_rows,
    surface_rows,
)

SHAPES = (
    "Mean over objects ± standard deviation over scenes (standard deviation over seeds). IoU and Chamfer: "
    "V-PRISM's protocol on a 15 mm grid; there even the true shapes score a Chamfer distance of about 8 mm. "
    "The columns at 5 mm judge delivered meshes; visible and hidden: mean distance of the true surface from "
    "the mesh, within 1 cm of what the camera saw and elsewhere. Missing: objects without any prediction, "
    "which count as IoU 0 and have no Chamfer distance."
)
MISSING = "Objects of which a method made no mesh on V-PRISM's grid (15 mm) or none of its own (5 mm)."
GALLERY = "Slices: blue is sure, yellow is uncertain; true outlines white, predicted ones black."
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


@dataclass(frozen=True)
class Section:
    """A title, a text, and a table (its first row the header) or pictures by title, as data: URLs."""

    title: str
    text: str = ""
    rows: list[list[str]] = field(default_factory=list)
    pictures: dict[str, str] = field(default_factory=dict)


def write_report(summary: dict[str, Any], figures: dict[str, Path], gallery: Path | None, path: Path) -> None:
    """Write report.html from a summary, figures by title and the gallery's picture."""
    from jinja2 import Environment, FileSystemLoader

    sections = [
        Section("Shapes", SHAPES, shape_rows(summary)),
        Section("Missing objects", MISSING, missing_rows(summary)),
        Section("Surfaces", SURFACES, surface_rows(summary)),
        Section("Uncertainty", CARD, card_rows(summary)),
        Section("Speed", SPEED, speed_rows(summary)),
        Section("Against V-PRISM", AGAINST, against_rows(summary)),
        Section("Figures", pictures={title: _embedded(file) for title, file in figures.items()}),
        Section("Gallery", GALLERY, pictures={"gallery": _embedded(gallery)} if gallery else {}),
        Section("Sturdy objects", STURDY, sturdy_rows(summary)),
        Section("Classes of objects", CLASSES, class_rows(summary)),
        Section("Significance", PAIRED, paired_rows(summary)),
        Section("Failures", rows=failure_rows(summary)),
    ]
    shown = [section for section in sections if len(section.rows) > 1 or section.pictures]
    # autoescape: names of objects come from other people's files.
    pages = Environment(loader=FileSystemLoader(Path(__file__).parent), autoescape=True)
    page = pages.get_template("report_page.html").render(summary=summary, sections=shown)
    write_atomically(path, page.encode())


def _embedded(path: Path) -> str:
    return f"data:image/png;base64,{base64.b64encode(path.read_bytes()).decode()}"
