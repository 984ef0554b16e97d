"""Convex parts: none bulges out of its mesh, feet are flat and parts stay."""

import numpy as np
import pytest
import trimesh
from boxes import box, part

from reconstruction.export.balance import ENOUGH, balanced
from reconstruction.export.collision import ConvexParts
from reconstruction.export.contacts import Contacts, contacts_of
from reconstruction.export.cutting import Cutter, solid_of
from reconstruction.export.footing import PATCH, with_footing
from reconstruction.export.hulls import Hull, convex_hull, surfaces
from reconstruction.export.parts_error import parts_error
from reconstruction.export.refine import bulges, refined
from reconstruction.export.tips import tips
from reconstruction.solid import Solid


def test_a_hull_over_a_hollow_is_halved_until_it_bulges_no_more():
    bent = trimesh.creation.box((0.08, 0.02, 0.02)).union(box((0.02, 0.02, 0.06), (0.03, 0, 0.03)))
    hull = np.asarray(bent.convex_hull.vertices)
    assert parts_error(bent, (convex_hull(hull),))[1] > 0.01
    cutter = Cutter(solid_of(bent.vertices, bent.faces), [hull])
    found = refined(cutter.hulls, Solid(bent), cutter.halve, 0.0025)
    missing, excess = parts_error(bent, found)
    assert len(found) > 1
    assert excess < 0.003
    assert missing < 0.001
    cube = trimesh.creation.box((0.05,) * 3)
    whole = Cutter(solid_of(cube.vertices, cube.faces), [np.asarray(cube.vertices)])
    (same,) = refined(whole.hulls, Solid(cube), whole.halve, 0.0025)
    assert np.allclose(np.sort(same.vertices, 0), np.sort(cube.vertices, 0))
    # What is convex is never cut, however far it is said to bulge; neither is what is not manifold.
    assert whole.halve([0], np.zeros((1, 3))) == [[]]
    assert Cutter(None, [hull]).halve([0], np.zeros((1, 3))) == [[]]


@pytest.mark.parametrize("middle", np.linspace(-0.04, 0.04, 9))
def test_what_sticks_out_along_an_edge_alone_is_found(middle):
    """A notch in a blade's edge: hardly any point drawn on its faces is as far out as the edge over it."""
    notch = trimesh.creation.cylinder(0.0033, 0.01, sections=48)
    notch.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    blade = box((0.3, 0.0004, 0.03), (0, 0, -0.015))
    notched = blade.difference(notch.apply_translation([middle, 0, 0]))
    ((depth, place),) = bulges(surfaces([Hull.of(blade)]), Solid(notched), 0.0027)
    assert 0.0027 < depth < 0.0034
    assert place[0] == pytest.approx(middle, abs=0.001)


def test_where_no_more_parts_are_allowed_the_worst_are_cut(monkeypatch):
    bar = trimesh.creation.box((0.2, 0.02, 0.02))
    holes = [
        box((0.02, 0.03, depth), (x, 0, 0.01 - depth / 2)) for x, depth in ((-0.05, 0.004), (0.05, 0.012))
    ]
    mesh = bar.difference(trimesh.util.concatenate(holes))
    ends = [box((0.0999, 0.03, 0.03), (x, 0, 0)).vertices for x in (-0.05, 0.05)]
    clouds = [np.clip(corners, *bar.bounds) for corners in ends]
    cutter = Cutter(solid_of(mesh.vertices, mesh.faces), clouds)
    monkeypatch.setattr("reconstruction.export.refine.MOST_PARTS", 3)
    found = refined(cutter.hulls, Solid(mesh), cutter.halve, 0.0025)
    assert len(found) == 3
    assert sum(part.bounds[1, 0] < 0.001 for part in found) == 1  # the one with the lesser hole stays whole


def test_a_splinter_beside_its_mesh_that_cannot_be_cut_is_left_out():
    body = trimesh.creation.box((0.05,) * 3)
    splinter = box((0.01, 0.0001, 0.001), (0, 0, 0.032))  # 1 mm^3, 7 mm off the body
    lump = box((0.01, 0.01, 0.01), (0, 0, 0.032))
    parts = surfaces([body, splinter, lump])

    def uncut(wanted, places):
        return [[] for _ in wanted]

    kept = refined(parts, Solid(body), uncut, 0.0025, splinter=2e-9)
    assert [len(part.vertices) for part in kept] == [8, 8]
    assert min(part.volume for part in kept) == pytest.approx(1e-6)
    assert len(refined(parts, Solid(body), uncut, 0.0025)) == 3
    near = surfaces([body, box((0.01, 0.0001, 0.001), (0, 0, 0.026))])
    assert len(refined(near, Solid(body), uncut, 0.0025, splinter=2e-9)) == 2  # it does not bulge


def test_a_part_bulges_less_where_another_mesh_is():
    grooved = trimesh.creation.box((0.08, 0.04, 0.02)).difference(box((0.03, 0.05, 0.004), (0, 0, 0.01)))
    in_it = Solid(box((0.028, 0.03, 0.02), (0, 0, 0.0185)))  # its lower end 1.5 mm deep in the groove of 2 mm
    (whole,) = refined(*_begun(grooved), 0.0027)
    assert parts_error(grooved, (whole,))[1] == pytest.approx(0.002, abs=1e-4)
    found = refined(*_begun(grooved), 0.0027, [in_it])
    points = np.concatenate([part.vertices for part in found])
    assert len(found) > 1
    assert parts_error(grooved, found)[1] < 0.001
    assert not in_it.inside(points.astype(np.float32)).any()


def test_a_thin_tip_that_no_part_covers_becomes_a_part_of_its_own():
    block = box((0.06, 0.06, 0.02), (0, 0, 0))
    thorn = trimesh.creation.cone(
        0.001, 0.006, transform=trimesh.transformations.translation_matrix([0, 0, 0.0099])
    )
    mesh = block.union(thorn)
    whole = Hull.of(block)
    assert parts_error(mesh, (whole,))[0] == pytest.approx(0.0059, abs=1e-4)
    (tip,) = tips(mesh, (whole,), 0.0025)
    missing, excess = parts_error(mesh, (whole, tip))
    assert missing < 1e-4
    assert excess < 1e-4
    assert tips(mesh, (whole, tip), 0.0025) == []
    assert tips(mesh, (whole,), 0.007) == []


def test_flat_things_keep_their_parts_when_they_get_their_foot():
    plate = box((0.1, 0.05, 0.0015), (0, 0, 0.001))  # all of it lies within the patch
    solid = trimesh.util.concatenate([plate, box((0.02, 0.02, 0.02), (0.05, 0, 0.011))])
    parts = ConvexParts((Hull.of(plate), part((0.02, 0.02, 0.02), (0.05, 0, 0.011))), solid)
    footed = with_footing(parts, solid, 0.0)
    assert len(footed.parts) == 2
    assert plate.bounds[1, 2] < PATCH
    assert footed.parts[0].bounds[:, 2] == pytest.approx([0, 0.00175])
    assert footed.error_m < 0.002


def test_a_centre_of_mass_outside_of_its_ground_is_moved_over_it_and_no_other():
    square = Contacts.upwards(np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]], float))
    inside = np.array([0.05, 0.04, 0.03])
    assert np.array_equal(balanced(inside, square, 0.15).centre, inside)
    assert balanced(inside, square, 0.15).room == pytest.approx(ENOUGH)
    moved = balanced(np.array([0.105, 0.05, 0.03]), square, 0.15)
    assert moved.centre == pytest.approx([0.1 - ENOUGH, 0.05, 0.03])
    assert moved.steady
    far = np.array([0.15, 0.05, 0.03])
    assert not balanced(far, square, 0.15).steady
    assert np.array_equal(balanced(far, square, 0.15).centre, far)
    assert balanced(far, square, 0.3).centre == pytest.approx([0.1 - ENOUGH, 0.05, 0.03])
    edge = Contacts(square.places[:2], square.pushes[:2])
    assert not balanced(np.array([0.05, 0.01, 0.03]), edge, 0.15).steady
    assert balanced(inside, Contacts(np.zeros((0, 3)), np.zeros((0, 3))), 0.15).room < 0


def test_a_leaning_board_is_held_by_what_it_leans_on_and_by_friction():
    foot = Contacts.upwards(np.array([[0, -0.05, 0], [0, 0.05, 0]], float))
    wall = Contacts(np.array([[0.03, -0.05, 0.1], [0.03, 0.05, 0.1]]), np.tile([-1.0, 0, 0], (2, 1)))
    centre = np.array([0.015, 0, 0.05])
    assert balanced(centre, foot.joined(wall), 0.1).steady
    assert not balanced(centre, foot, 0.1).steady
    behind = Contacts(wall.places, -wall.pushes)  # it pushes the board over
    assert not balanced(centre, foot.joined(behind), 0.05).steady
    wedge = Contacts(
        np.array([[0.05, 0, 0.05], [-0.05, 0, 0.05]]), np.array([[-0.98, 0, 0.2], [0.98, 0, 0.2]])
    )
    assert balanced(np.array([0, 0, 0.05]), wedge, 0.1).room < 0  # it would slip
    # A touch at one side alone does not widen a narrow foot.
    beside = Contacts(np.array([[0.0, 0.05, 0.1]]), np.array([[0, -1.0, 0]]))
    assert not balanced(centre, foot.joined(beside), 0.1).steady


def test_what_hovers_a_little_gets_feet_down_to_the_support_where_it_is_lowest():
    legs = [box((0.02, 0.02, 0.05), (x, 0, 0.027)) for x in (-0.04, 0.04)]  # their lowest points at z = 2 mm
    top = box((0.1, 0.02, 0.01), (0, 0, 0.057))
    solid = trimesh.boolean.union([*legs, top])
    legs, top = [Hull.of(leg) for leg in legs], Hull.of(top)
    footed = with_footing(ConvexParts((*legs, top), solid), solid, 0.0)
    lows = sorted(part.bounds[0, 2] for part in footed.parts)
    assert lows == pytest.approx([0, 0, 0.052])
    assert footed.error_m == pytest.approx(0.002, abs=1e-4)
    assert with_footing(ConvexParts((*legs, top), solid), solid, -0.002).parts == (
        *legs,
        top,
    )  # blocks do that
    assert with_footing(ConvexParts((*legs, top), solid), solid, -0.01).parts == (*legs, top)


def test_a_part_too_round_for_a_foot_stands_on_a_foot_of_its_own():
    ball = trimesh.creation.icosphere(4, 0.04)
    cut = with_footing(ConvexParts((Hull.of(ball),), ball), ball, -0.04)
    patch = [one for one in cut.parts if np.ptp(one.vertices[one.vertices[:, 2] < -0.0399][:, 0]) > 0.02]
    assert patch
    assert cut.error_m < 3e-3


def test_things_touch_the_support_and_what_is_below_or_beside_them():
    table_box, upper = part((0.1,) * 3, (0, 0, 0.05)), part((0.1,) * 3, (0.05, 0, 0.152))
    objects = {1: (table_box,), 2: (upper,)}
    ground = contacts_of(1, objects)
    assert set(np.round(ground.places[:, 2], 3)) == {0.0}  # what lies on it pushes it down
    resting = contacts_of(2, objects)
    assert set(np.round(resting.places[:, 2], 3)) == {0.1, 0.102}
    assert resting.places[:, 0].min() == pytest.approx(0.0)
    assert np.allclose(resting.pushes, [0, 0, 1])
    beside = contacts_of(2, {1: (table_box,), 2: (part((0.1,) * 3, (0.102, 0, 0.06)),)})
    assert len(beside.places)
    assert np.allclose(beside.pushes, [1, 0, 0])
    assert len(contacts_of(2, {2: (upper,)}).places) == 0


def _begun(mesh):
    """What `refined` wants of a mesh that is its own first part: hulls, solid and how they are halved."""
    cutter = Cutter(solid_of(mesh.vertices, mesh.faces), [np.asarray(mesh.vertices)])
    return cutter.hulls, Solid(mesh), cutter.halve
