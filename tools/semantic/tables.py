"""Tables of what semantic maps cost. Knows figures and text; must not know how they were measured."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tools.markdown import markdown_table
from tools.reproduce.runs import seconds
from tools.reproduce.semantic.methods import METHODS, TITLES

HEADER = ["", "points", "classes", "hinge points", "wall (CPU) [s]", "peak memory of the process [MB]"]


def scans_table(scans: dict[str, dict[str, Any]], merged: dict[str, dict[str, Any]]) -> str:
    """Fits and queries of real scans, and below each scan the methods side by side."""
    rows, compared = [HEADER], []
    for name, found in scans.items():
        rows.append(_fit_row(f"fit: first scan of {name}", found["fit"]))
        ask = found["ask"]
        rows.append(
            [
                f"{ask['asked']:,.0f} queries around it",
                *[""] * 3,
                _time(ask, "ask"),
                f"{ask['peak_mb']:.0f}",
            ]
        )
        compared.append(_compared(name, found["compare"]))
    for name, found in merged.items():
        rows.append(_fit_row(f"fit: all scans of {name} as one map", found["merged"]))
    return "\n".join([markdown_table(rows), *compared])


def tiles_table(rows: Sequence[dict[str, Any]]) -> str:
    """One tile against many."""
    header = [
        *(
            "sequence",
            "fit",
            "one tile, CPU (wall) [s]",
            "many, CPU (wall) [s]",
            "tiles",
        ),
        *("mIoU one", "mIoU many", "same label", "same to 1e-3 away from seams"),
        *("away: median, 90 %, 99 %", "near: median, 90 %, 99 %"),
    ]
    table = [header]
    for row in rows:
        table.append(
            [
                row["sequence"],
                f"{row['steps']} local steps"
                if row["steps"]
                else f"{row['taken']:.0f} steps, to {row['tolerance']:g} nats",
                *(f"{seconds(row[f'{k}_cpu_s'])} ({seconds(row[f'{k}_s'])})" for k in ("one", "many")),
                f"{row['tiles']:.0f}",
                f"{row['miou_one']:.4f}",
                f"{row['miou_many']:.4f}",
                f"{100 * row['label_same']:.2f} %",
                f"{100 * row['away_same']:.1f} %",
                *(
                    ", ".join(f"{row[f'{where}_{q}']:.1e}" for q in (50, 90, 99))
                    for where in ("away", "seams")
                ),
            ]
        )
    return markdown_table(table)


def killed_table(found: dict[str, Any]) -> str:
    """Whether a run's bytes depend on what was killed."""
    said = {1.0: "the same bytes", 0.0: "OTHER BYTES"}
    return (
        f"{found['points']:,.0f} points, {found['tiles']:.0f} tiles, {found['files']:.0f} files of tiles and "
        f"voxels; {found['deaths']:.0f} processes killed. Workers killed in the middle of a fit and of "
        f"writing: {said[found['worker_same']]}. The whole run killed and run again: "
        f"{said[found['run_same']]}.\n"
    )


def _fit_row(name: str, found: dict[str, float]) -> list[str]:
    counts = (f"{found[key]:,.0f}" for key in ("points", "classes", "hinges"))
    return [name, *counts, _time(found, "fit"), f"{found['peak_mb']:.0f}"]


def _compared(name: str, found: dict[str, float]) -> str:
    """Times of all methods, and how many times ContraMap's they are: of a processor, for not all use all."""
    from tools.semantic.costs import COMPARED

    header = ["first scan of " + name, "fit, wall (CPU) [s]", f"{COMPARED:,} queries, wall (CPU) [s]"]
    table = [[*header, "queries, times ContraMap's CPU"]]
    for method in METHODS:
        ratio = found[f"{method}_ask_cpu_s"] / found["contramap_ask_cpu_s"]
        times = (_time(found, f"{method}_{part}") for part in ("fit", "ask"))
        table.append([TITLES[method], *times, f"{ratio:.2f}"])
    return markdown_table(table)


def _time(found: dict[str, float], name: str) -> str:
    return f"{seconds(found[f'{name}_s'])} ({seconds(found[f'{name}_cpu_s'])})"
