"""Results by class of object, and of the sturdy ones: what is thick enough for a grid of 5 to 15 mm."""

from __future__ import annotations

import re
from collections import defaultdict
from typing import Any

import numpy as np

STURDY = {
    "cans": ("001", "002", "005", "007", "010"),
    "boxes": ("003", "004", "008", "009"),
    "bottles": ("006", "021", "022"),
    "fruit": ("011", "012", "013", "014", "015", "016", "017", "018"),
    "drill": ("035",),
}
"""YCB numbers of the sturdy objects: cans, boxes and bottles of food and cleaners, fruit, the power drill."""
STURDY_NUMBERS = frozenset(number for numbers in STURDY.values() for number in numbers)
CLASS_METRICS = ("iou", "chamfer_mm", "iou_5mm", "chamfer_5mm")

Objects = dict[tuple[str, int], dict[str, Any]]
"""(scene, label) -> name and each of CLASS_METRICS averaged over seeds; None where no seed has a value."""


def class_of(name: str) -> str:
    """The class of an object: variants such as 065-a_cups and 065-b_cups are one, 065_cups."""
    return re.sub(r"^(\d+)-\w+?_", r"\1_", name)


def is_sturdy(name: str) -> bool:
    """Whether an object's name starts with the YCB number of a sturdy one."""
    return name[:3] in STURDY_NUMBERS


def objects_of(results: list[dict[str, Any]], method: str) -> Objects:
    """All judged objects of a method."""
    pools: dict[tuple[str, int], list[dict[str, Any]]] = defaultdict(list)
    for result in results:
        if result["method"] == method:
            for item in result["objects"]:
                pools[result["scene"], item["label"]].append(item)
    return {
        key: {
            "name": items[0]["name"],
            **{metric: _mean([item.get(metric) for item in items]) for metric in CLASS_METRICS},
        }
        for key, items in pools.items()
    }


def sturdy_summary(results: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """{method: {objects, and the mean of each of CLASS_METRICS}} over sturdy objects."""
    found = {}
    for method in dict.fromkeys(result["method"] for result in results):
        items = [item for item in objects_of(results, method).values() if is_sturdy(item["name"])]
        if items:
            found[method] = {"objects": len(items), **_means(items)}
    return found


def class_comparison(results: list[dict[str, Any]], method: str, other: str) -> list[dict[str, Any]]:
    """Two methods class by class, on the objects both were judged on, the greatest loss of IoU first.

    Each {class, objects, sturdy, <method>: means of CLASS_METRICS, <other>: ..., difference: of IoU}.
    """
    mine, theirs = (objects_of(results, name) for name in (method, other))
    groups: dict[str, list[tuple[dict[str, Any], dict[str, Any]]]] = defaultdict(list)
    for key in sorted(set(mine) & set(theirs)):
        groups[class_of(mine[key]["name"])].append((mine[key], theirs[key]))
    rows = []
    for name, pairs in groups.items():
        means = [_means(list(side)) for side in zip(*pairs)]
        gains = [a["iou"] - b["iou"] for a, b in pairs]  # an object without prediction has IoU 0, never None
        rows.append(
            {
                "class": name,
                "objects": len(pairs),
                "sturdy": is_sturdy(name),
                method: means[0],
                other: means[1],
                "difference": float(np.mean(gains)),
            }
        )
    return sorted(rows, key=lambda row: row["difference"])


def _means(items: list[dict[str, Any]]) -> dict[str, float | None]:
    return {metric: _mean([item[metric] for item in items]) for metric in CLASS_METRICS}


def _mean(values: list[float | None]) -> float | None:
    given = [value for value in values if value is not None]
    return float(np.mean(given)) if given else None
