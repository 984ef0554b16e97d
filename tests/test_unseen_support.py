"""Blocks below what stands on nothing known: in unseen space, clear of all objects, under the centre of
mass."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from boxes import part

from perception.camera import Camera
from perception.frame import Frame
from reconstruction.export.apart import overlap
from reconstruction.export.at_rest import at_rest
from reconstruction.export.balance import room_within
from reconstruction.export.hulls import Hull
from reconstruction.export.seen_free import CLEAR, seen_free
from reconstruction.export.unseen_support import BELOW, MOST, THIN, unseen_support
from reconstruction.export.unseen_support import CLEAR as GAP_BESIDE


def nothing(points):
    return np.zeros(len(points), bool)


def test_a_hovering_box_gets_blocks_that_hold_it():
    hovering = part((0.1, 0.06, 0.04), (0, 0, 0.06))  # its underside at z = 4 cm
    blocks = unseen_support((hovering,), [], np.array([0.02, 0, 0.06]), nothing)
    assert 3 <= len(blocks) <= MOST
    assert room_within(np.array([0.02, 0, 0.06]), np.array([block.centre for block in blocks])) > 0.006
    for block in blocks:
        assert block.top == pytest.approx(0.04 - BELOW, abs=1e-6)
        assert block.hull.mesh.volume == pytest.approx(np.prod(block.size))
        assert block.corners.min(0) == pytest.approx(block.hull.bounds[0])


def test_no_block_is_where_nothing_was_seen_to_be():
    hovering = part((0.1, 0.06, 0.04), (0, 0, 0.06))
    assert unseen_support((hovering,), [], np.zeros(3), lambda points: np.ones(len(points), bool)) == ()
    half = unseen_support((hovering,), [], np.zeros(3), lambda points: points[:, 0] > 0)
    assert half
    assert all(block.corners[:, 0].max() <= 1e-9 for block in half)
    low = part((0.1, 0.06, 0.04), (0, 0, 0.0207))  # 0.7 mm above the support: no room
    assert unseen_support((low,), [], np.zeros(3), nothing) == ()


def test_blocks_keep_clear_of_other_objects_and_are_thin_where_they_must():
    hovering = part((0.1, 0.06, 0.04), (0, 0, 0.06))
    beside = (part((0.05, 0.1, 0.05), (0.03, 0, 0.025)),)  # it ends above the underside
    blocks = unseen_support((hovering,), [beside], np.zeros(3), nothing)
    assert blocks
    assert all(overlap(block.hull, beside[0], GAP_BESIDE) is None for block in blocks)
    below = (part((0.2, 0.1, 0.03), (0, 0, 0.015)),)  # 10 mm below it
    thin = unseen_support((hovering,), [below], np.zeros(3), nothing)
    assert {round(float(block.size[2]), 6) for block in thin} == {THIN}


def test_a_tip_between_the_places_looked_at_is_not_stuck_in_a_block():
    tip = Hull.of(
        trimesh.creation.cone(0.0007, 0.004)
        .apply_transform(np.diag([1.0, -1, -1, 1]))
        .apply_translation([0.0008, 0, 0.04])
    )
    hovering = (part((0.1, 0.06, 0.04), (0, 0, 0.06)), tip)
    blocks = unseen_support(hovering, [], np.array([0, 0, 0.06]), nothing)
    assert len(blocks) == MOST
    assert all(overlap(block.hull, part, 0.0) is None for block in blocks for part in hovering)


def test_an_underside_is_followed_and_its_lowest_places_are_taken_first():
    table_top, leg = part((0.1, 0.1, 0.01), (0, 0, 0.1)), part((0.04, 0.04, 0.06), (0, 0, 0.065))
    tops = [b.top for b in unseen_support((table_top, leg), [], np.array([0, 0, 0.1]), nothing)]
    assert max(tops) == pytest.approx(0.035 - BELOW, abs=1e-6)
    aside = [b.top for b in unseen_support((table_top, leg), [], np.array([0.03, 0, 0.1]), nothing)]
    assert max(aside) == pytest.approx(0.095 - BELOW, abs=1e-6)


def test_what_stands_gets_none_and_what_hovers_keeps_its_mass_where_it_is():
    objects = {1: (part((0.1,) * 3, (0, 0, 0.05)),), 2: (part((0.05,) * 3, (0.3, 0, 0.06)),)}
    centres = {1: np.array([0, 0, 0.05]), 2: np.array([0.3, 0, 0.06])}
    found = at_rest(objects, centres, nothing)
    assert list(found.supports) == [2]
    assert all(np.array_equal(found.centres[label], centres[label]) for label in centres)


def test_a_foot_beside_its_centre_of_mass_is_not_enough():
    crane = (part((0.02, 0.02, 0.1), (0, 0, 0.05)), part((0.3, 0.02, 0.02), (0.14, 0, 0.11)))
    found = at_rest({1: crane}, {1: np.array([0.15, 0, 0.09])}, nothing)
    assert (
        room_within(np.array([0.15, 0, 0.09]), np.array([block.centre for block in found.supports[1]]))
        > 0.006
    )
    near = at_rest({1: crane}, {1: np.array([0.05, 0, 0.09])}, nothing)  # mass is moved that far
    assert near.supports == {}
    assert near.centres[1][0] < 0.01


def test_places_before_what_was_measured_were_seen_to_be_free():
    camera = Camera(np.array([[100.0, 0, 50], [0, 100, 40], [0, 0, 1]]), 100, 80)
    depth = np.full((80, 100), 0.5, np.float32)
    depth[:, :20] = np.nan
    frame = Frame(depth, camera)
    points = np.array(
        [[0, 0, 0.4], [0, 0, 0.5 - CLEAR / 2], [0, 0, 0.6], [0, 0, -0.4], [0.9, 0, 0.4], [-0.19, 0, 0.4]]
    )
    assert seen_free(points, [frame]).tolist() == [True, False, False, False, False, False]
    far = Frame(np.full((80, 100), 0.9, np.float32), camera)
    assert seen_free(points, [frame, far])[2]
