"""The text beside a recording: objects, stages, fit and what was skipped, as Markdown.

Knows results; knows nothing of rerun.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from reconstruction.files.stored import StoredObject
    from reconstruction.result import ReconstructedObject, Reconstruction


def run_summary(reconstruction: Reconstruction) -> str:
    """Objects, timings, fit and what was skipped, as Markdown."""
    report, support = reconstruction.map.report, reconstruction.observation.support
    end = "converged" if report.converged else "stopped"
    lines = _object_lines(reconstruction.objects) + _timing_lines(reconstruction.timings_ms)
    lines += ["", f"Fit: {end} after {report.iterations} steps, seed {reconstruction.seed}."]
    if support is not None:
        lines += ["", f"Support plane: {support.inlier_ratio:.0%} of the unlabelled pixels lie on it."]
    lines += [f"- skipped {item.name} (label {item.label}): {item.reason}" for item in reconstruction.skipped]
    lines += [f"- {note}" for note in reconstruction.notes]
    return "\n".join(lines)


def stored_summary(objects: Sequence[StoredObject], timings_ms: Mapping[str, float]) -> str:
    """Objects and timings, as Markdown."""
    return "\n".join(_object_lines(objects) + _timing_lines(timings_ms))


def _object_lines(objects: Sequence[ReconstructedObject | StoredObject]) -> list[str]:
    lines = ["| object | size [cm] | mean p(uncertain) |", "|---|---|---|"]
    for item in objects:
        size = " x ".join(f"{100 * extent:.1f}" for extent in item.extents)
        mean = float(np.mean(item.uncertainty))
        lines.append(f"| {item.label} {_escape(item.name)} | {size} | {mean:.2f} |")
    return lines


def _timing_lines(timings_ms: Mapping[str, float]) -> list[str]:
    rows = [f"| {stage} | {value:.1f} |" for stage, value in timings_ms.items()]
    return ["", "| stage | ms |", "|---|---|", *rows]


def _escape(name: str) -> str:
    return "".join(c if c.isalnum() or c in " ._-" else f"&#{ord(c)};" for c in name)
