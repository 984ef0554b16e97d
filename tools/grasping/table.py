"""Figures of grasping as tables for people. Knows the figures and markdown."""

from __future__ import annotations

from typing import Any

from tools.grasping.play import CONDITIONS
from tools.markdown import markdown_table


def tables(summary: dict[str, Any]) -> list[str]:
    """Markdown: success by condition, by group, by occlusion, differences, over coverage, and failures."""
    conditions = summary["conditions"]
    return [
        "## Success\n\n" + _success(conditions),
        "## By objects and arrangement\n\n" + _parts(conditions, "by_group"),
        "## By how much others hide of the target\n\n" + _parts(conditions, "by_hidden"),
        "## Difference in success, row minus column, in points (95 % over rounds)\n\n"
        + _differences(summary["differences"]),
        "## Success among the attempts with the best scores\n\n" + _coverage(conditions),
        "## What became of the attempts\n\n" + _counts(conditions, "reasons"),
        "## Why rounds ended\n\n" + _counts(conditions, "ended"),
    ]


def _success(conditions: dict[str, Any]) -> str:
    rows = [["condition", "shapes", "attempts", "success", "cleared", "rounds", "plan [s]"]]
    for name, item in conditions.items():
        cleared = _interval(item["cleared"], item["cleared_low"], item["cleared_high"])
        plan = "" if item["plan_s"] is None else f"{item['plan_s']:.2f}"
        row = [name, CONDITIONS[name].about, str(item["attempts"]), _rate(item), cleared]
        rows.append([*row, str(item["rounds"]), plan])
    return markdown_table(rows)


def _parts(conditions: dict[str, Any], key: str) -> str:
    names = list(dict.fromkeys(part for item in conditions.values() for part in item[key]))
    rows = [["condition", *names]]
    for name, item in conditions.items():
        cells = [item[key].get(part) for part in names]
        rows.append([name, *(_counted(cell) if cell and cell["attempts"] else "" for cell in cells)])
    return markdown_table(rows)


def _counted(cell: dict[str, Any]) -> str:
    return f"{_rate(cell)}, n = {cell['attempts']}"


def _differences(differences: dict[str, Any]) -> str:
    names = list(differences)
    rows = [["", *names]]
    for name in names:
        cells = [differences[name].get(other) for other in names]
        rows.append([name, *("" if not c or "success" not in c else _points(c) for c in cells)])
    return markdown_table(rows)


def _points(cell: dict[str, float]) -> str:
    return f"{100 * cell['success']:+.0f} ({100 * cell['low']:+.0f} to {100 * cell['high']:+.0f})"


def _coverage(conditions: dict[str, Any]) -> str:
    shares = list(dict.fromkeys(step["share"] for item in conditions.values() for step in item["coverage"]))
    rows = [["condition", *(f"best {share:.0%}" for share in shares)]]
    for name, item in conditions.items():
        steps = {step["share"]: step for step in item["coverage"]}
        rows.append([name, *(_rate(steps[share]) if share in steps else "" for share in shares)])
    return markdown_table(rows)


def _counts(conditions: dict[str, Any], key: str) -> str:
    names = sorted({name for item in conditions.values() for name in item[key]})
    rows = [["condition", *names]]
    rows += [[name, *(str(item[key].get(n, 0)) for n in names)] for name, item in conditions.items()]
    return markdown_table(rows)


def _rate(item: dict[str, Any]) -> str:
    return "" if item["success"] is None else _interval(item["success"], item["low"], item["high"])


def _interval(value: float, low: float, high: float) -> str:
    return f"{100 * value:.0f} % ({100 * low:.0f}-{100 * high:.0f})"
