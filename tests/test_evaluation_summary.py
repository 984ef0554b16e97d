"""Comparisons drawn from kept results, on results whose answers are known."""

from __future__ import annotations

from typing import Any

import pytest

from tools.evaluation.against import against
from tools.evaluation.classes import class_comparison, class_of, is_sturdy, sturdy_summary
from tools.evaluation.summary import summarise
from tools.evaluation.table import all_tables

CARD = {"occlusion_auroc": 0.9, "aurc": 0.01}


def result(method: str, scene: str, seed: int, iou: dict[str, float], **values: Any) -> dict[str, Any]:
    """A kept result with objects of the given names and IoUs; Chamfer distances are 10 (1 - IoU) mm."""
    objects = [
        {
            "label": label,
            "name": name,
            "iou": value,
            "iou_5mm": value,
            "chamfer_mm": 10 * (1 - value) if value else None,
            "chamfer_5mm": 10 * (1 - value) if value else None,
        }
        for label, (name, value) in enumerate(iou.items(), start=1)
    ]
    seconds = {f"{stage}{kind}": 1.0 for stage in ("fit", "mesh", "mesh_5mm") for kind in ("_s", "_cpu_s")}
    content = {
        "scene": scene,
        "method": method,
        "seed": seed,
        "object_count": len(objects),
        "objects": objects,
    }
    return {**content, "card": CARD, "nulls": {}, **seconds, **values}


@pytest.fixture
def results() -> list[dict[str, Any]]:
    can, cup, other = "005_tomato_soup_can", "065-a_cups", "065-j_cups"
    return [
        result("contramap", "s0", 0, {can: 0.8, cup: 0.2}),
        result("contramap", "s0", 1, {can: 0.6, cup: 0.4}),
        result("contramap", "s1", 0, {other: 0.3}),
        result("contramap", "s2", 0, {can: 0.1}),
        result("vprism", "s0", 0, {can: 0.5, cup: 0.0}, fit_cpu_s=9.0, card={**CARD, "aurc": 0.04}),
        result("vprism", "s1", 0, {other: 0.8}, fit_cpu_s=29.0, object_count=7),
        result("tsdf", "s2", 0, {can: 0.4}),
    ]


def test_names_become_classes() -> None:
    assert class_of("065-a_cups") == class_of("065-j_cups") == "065_cups"
    assert class_of("072-b_toy_airplane") == "072_toy_airplane"
    assert class_of("005_tomato_soup_can") == "005_tomato_soup_can"
    assert is_sturdy("035_power_drill")
    assert not is_sturdy("065-a_cups")
    assert not is_sturdy("box_1")


def test_classes_are_compared_on_shared_objects_seeds_averaged(results) -> None:
    worst, best = class_comparison(results, "contramap", "vprism")
    assert (worst["class"], worst["objects"], worst["sturdy"]) == ("065_cups", 2, False)
    assert worst["difference"] == pytest.approx((0.3 - 0.0 + 0.3 - 0.8) / 2)
    assert worst["contramap"]["iou"] == pytest.approx(0.3)
    assert worst["vprism"]["chamfer_mm"] == pytest.approx(2.0)  # of the cup that has a mesh
    assert (best["class"], best["sturdy"], best["difference"]) == (
        "005_tomato_soup_can",
        True,
        pytest.approx(0.2),
    )


def test_sturdy_objects_are_averaged(results) -> None:
    found = sturdy_summary(results)
    assert found["contramap"]["objects"] == 2
    assert found["contramap"]["iou"] == pytest.approx((0.7 + 0.1) / 2)
    assert found["tsdf"]["iou"] == pytest.approx(0.4)


def test_only_shared_scenes_count_against_vprism(results) -> None:
    (row,) = against(results)  # tsdf shares no scene with V-PRISM
    assert (row["method"], row["reference"], row["scenes"], row["objects"]) == ("contramap", "vprism", 2, 3)
    assert row["iou_gain"] == pytest.approx((0.2 + 0.3 - 0.5) / 3)
    assert row["chamfer_ratio"] == pytest.approx(
        (3.0 + 7.0) / (5.0 + 2.0)
    )  # the cup without mesh is left out
    assert row["aurc_ratio"] == pytest.approx(0.01 / 0.025)
    assert row["faster"] == pytest.approx((5 + 15) / 2)
    assert (row["crowded_scenes"], row["faster_crowded"]) == (0, None)  # as many objects as the method saw


def test_tables_name_every_comparison(results) -> None:
    text = "\n".join(all_tables(summarise(results)))
    for title in ("Shapes", "Speed", "Against V-PRISM", "Sturdy objects", "Classes of objects"):
        assert f"### {title}" in text
    assert "065_cups" in text
    without = summarise([item for item in results if item["method"] != "vprism"])
    assert without["classes"] == without["against"] == []
