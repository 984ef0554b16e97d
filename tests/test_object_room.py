"""How far beyond what is seen an object is looked for: as before for small things, more for large."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import Shape, make_tabletop

from perception.observation import near_boxes
from perception.observing import observe
from reconstruction.config import preset
from reconstruction.fitted_scene import object_space


@pytest.fixture(scope="module")
def observation():
    """A box, and the same six times as large."""
    found = observe(make_tabletop(shapes=(Shape("box", (0.06, 0.06, 0.08), (0.0, 0.0, 0.04), 0.0),)).frame)
    small = found.objects[0]
    return replace(found, objects=(small, replace(small, label=2, points=6 * small.points)))


def test_room_grows_with_what_is_seen_of_large_objects_alone(observation) -> None:
    mesh = preset("tabletop").mesh
    lows, highs = object_space(observation, mesh.margin, mesh.margin_share)
    for item, low, high in zip(observation.objects, lows, highs):
        seen_low, seen_high = item.bounds
        width = float((seen_high - seen_low)[:2].max())
        room = max(mesh.margin, mesh.margin_share * width)
        np.testing.assert_allclose(seen_low[:2] - low[:2], room, atol=1e-5)
        np.testing.assert_allclose(high - seen_high, room, atol=1e-5)
    rooms = [item.reach(mesh.margin, mesh.margin_share) for item in observation.objects]
    assert min(rooms) == mesh.margin
    assert max(rooms) > 1.3 * mesh.margin


def test_the_paper_preset_keeps_its_margin() -> None:
    assert preset("paper").mesh.margin_share == 0


def test_each_box_can_have_a_reach_of_its_own() -> None:
    boxes = [(np.zeros(3), np.ones(3)), (np.full(3, 5.0), np.full(3, 6.0))]
    points = np.array([[1.5, 0.5, 0.5], [6.5, 5.5, 5.5], [3, 3, 3]], np.float32)
    assert near_boxes(points, boxes, [0.1, 1.0]).tolist() == [False, True, False]
    assert near_boxes(points, boxes, 0.6).tolist() == [True, True, False]
