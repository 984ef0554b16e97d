"""Convex parts of neighbours: none reaches into another, and what planes take too much of is put back."""

import numpy as np
import pytest
import trimesh
from boxes import box, part

from reconstruction.export import mjcf, urdf
from reconstruction.export.apart import below, kept_apart, overlap
from reconstruction.export.carving import carved
from reconstruction.export.collision import convex_parts
from reconstruction.export.hulls import Hull, convex_hull
from reconstruction.export.parts_error import parts_error
from reconstruction.export.put_back import put_back
from reconstruction.solid import Solid

GAP = 0.002
"""Between parts of two objects [m]."""


def prism(corners) -> trimesh.Trimesh:
    """6 cm along y; corners (N, 2): its x and z [m]."""
    ends = [[[x, y, z] for x, z in corners] for y in (-0.03, 0.03)]
    return convex_hull(np.concatenate(ends)).mesh


def test_two_boxes_that_overlap_are_cut_at_a_plane_between_them():
    one, two = part((0.1, 0.1, 0.1), (0, 0, 0)), part((0.1, 0.08, 0.08), (0.095, 0, 0))
    normal, low, high = overlap(one, two, GAP)
    assert np.allclose(normal, [1, 0, 0])
    assert high - low == pytest.approx(0.005)
    apart = kept_apart({1: (one,), 2: (two,)}, GAP)
    (first,), (second,) = apart[1], apart[2]
    assert first.bounds[1, 0] == pytest.approx(0.0475 - GAP / 2)
    assert second.bounds[0, 0] == pytest.approx(0.0475 + GAP / 2)
    assert overlap(first, second, GAP) is None
    assert first.mesh.is_watertight
    assert second.volume == pytest.approx(0.08 * 0.08 * (0.145 - 0.0475 - GAP / 2))


def test_parts_that_do_not_overlap_stay_as_they_are_and_an_object_never_loses_all():
    one, two, far = (part((0.1,) * 3, (x, 0, 0)) for x in (0, 0.11, 1))
    apart = kept_apart({1: (one,), 2: (two, far)}, GAP)
    assert apart[1][0] is one
    assert apart[2] == (two, far)
    tiny = part((1e-3,) * 3, (0, 0, 0))
    assert kept_apart({1: (one,), 2: (tiny,)}, GAP)[2]


@pytest.mark.parametrize("gap", [mjcf.GAP, urdf.GAP])
def test_thin_plates_and_a_wedge_that_touch_others_keep_their_shape(gap):
    """As reconstructions touch: parts that bulge into a neighbour are cut, little of a mesh is lost."""
    plates = box((0.1, 0.08, 0.0025), (0, 0, 0.00125)), box((0.1, 0.08, 0.0025), (0, 0, 0.00375))
    wedge = prism([[-0.03, 0], [0.03, 0], [0, -0.05]])  # 62 degrees, tip down
    left, right = (prism([[0, -0.05], [x, 0], [x, -0.05]]) for x in (-0.03, 0.03))
    for meshes in (plates, (wedge, left, right)):
        cut = convex_parts(meshes, workers=1)
        bulging = {
            label: tuple(convex_hull(one.vertices * 1.02) for one in of_one.parts)
            for label, of_one in enumerate(cut)
        }
        apart = kept_apart(carved(bulging, dict(enumerate(meshes)), gap) if gap else bulging, gap)
        for label, mesh in enumerate(meshes):
            missing, excess = parts_error(mesh, apart[label])
            assert missing < 0.003
            assert excess < 0.003
            others = [part for other, parts in apart.items() if other != label for part in parts]
            assert all(overlap(own, part, gap) is None for own in apart[label] for part in others)


def test_what_bulges_over_a_notch_with_a_neighbour_in_it_is_carved():
    """Planes alone would take a layer from all of the notched block, or off the end of what stands in it."""
    whole, standing = box((0.1, 0.06, 0.03), (0, 0, 0)), box((0.02, 0.06, 0.05), (0, 0, 0.032))
    notched = whole.difference(box((0.02, 0.07, 0.05), (0, 0, 0.032)))
    meshes, parts = {1: notched, 2: standing}, {1: (Hull.of(whole),), 2: (Hull.of(standing),)}
    planes, found = kept_apart(parts, GAP), kept_apart(carved(parts, meshes, GAP), GAP)
    errors = [[max(parts_error(meshes[k], of_one[k])) for k in meshes] for of_one in (planes, found)]
    assert max(errors[0]) > 0.0045
    assert max(errors[1]) < 0.0015
    assert all(overlap(part, other, GAP) is None for part in found[1] for other in found[2])
    assert len(found[1]) < 20
    far = standing.copy().apply_translation([0.2, 0, 0])
    alone = {1: parts[1], 2: (Hull.of(far),)}
    apart = carved(alone, {1: notched, 2: far}, GAP)
    assert apart[1] is alone[1]
    assert apart[2] is alone[2]


@pytest.mark.parametrize("gap", [mjcf.GAP, urdf.GAP])
def test_what_a_plane_took_beside_a_neighbour_is_put_back_around_it(gap):
    """A thin plate in a pocket of a slab whose part closes it: the plane between takes the slab's top."""
    slab, plate = box((0.1, 0.1, 0.03), (0, 0, 0)), box((0.02, 0.02, 0.0015), (0.01, 0, 0.0112))
    mesh = slab.difference(box((0.026, 0.026, 0.005), (0.01, 0, 0.0126)))
    far = part((0.01,) * 3, (0.3, 0, 0))
    whole, meshes = {1: (Hull.of(slab),), 2: (Hull.of(plate),), 3: (far,)}, {1: mesh, 2: plate, 3: far.mesh}
    planes = kept_apart(whole, gap)
    found = put_back(planes, whole, meshes, gap)
    assert parts_error(mesh, planes[1])[0] > 0.0035
    assert parts_error(mesh, found[1])[0] < 0.0026
    assert found[1][:1] == planes[1]
    assert len(found[1]) < 8
    assert all(overlap(one, other, gap) is None for one in found[1] for other in found[2])
    assert found[3] == whole[3]
    assert put_back(whole, whole, meshes, gap) == whole  # nothing was cut


def test_a_thin_plate_keeps_its_body_where_it_lies_on_a_thick_one():
    plate, block = box((0.1, 0.1, 0.0012), (0, 0, 0.0006)), box((0.1, 0.1, 0.05), (0, 0, -0.025))
    parts = {1: (Hull.of(plate),), 2: (Hull.of(block),)}
    apart = kept_apart(parts, GAP)
    assert np.ptp(apart[1][0].vertices[:, 2]) > 0.001
    assert np.ptp(apart[2][0].vertices[:, 2]) == pytest.approx(0.048, abs=2e-4)
    apart = carved(parts, {1: plate, 2: block}, GAP)
    assert np.ptp(apart[1][0].vertices[:, 2]) > 0.001
    assert np.ptp(apart[2][0].vertices[:, 2]) == pytest.approx(0.048, abs=2e-4)


@pytest.mark.parametrize(("gap", "distance"), [(mjcf.GAP, 0.0), (urdf.GAP, 0.002)])
def test_boxes_that_touch_are_as_far_apart_as_the_format_needs(gap, distance):
    apart = kept_apart({1: (part((0.1,) * 3, (0, 0, 0)),), 2: (part((0.1,) * 3, (0.1, 0, 0)),)}, gap)
    assert apart[2][0].bounds[0, 0] - apart[1][0].bounds[1, 0] == pytest.approx(distance, abs=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_hulls_in_any_attitude_do_not_overlap_when_cut(seed):
    rng = np.random.default_rng(seed)
    clouds = [rng.normal(size=(30, 3)) * 0.03, rng.normal(size=(30, 3)) * 0.03 + [0.07, 0, 0]]
    one, two = (convex_hull(cloud) for cloud in clouds)
    apart = kept_apart({1: (one,), 2: (two,)}, GAP)
    assert overlap(apart[1][0], apart[2][0], GAP) is None
    for before, after in ((one, apart[1][0]), (two, apart[2][0])):
        corners = after.vertices.astype(np.float32)
        solid = Solid(before.mesh)
        assert (solid.inside(corners) | (solid.distance(corners) < 1e-5)).all()


def test_a_face_without_area_parts_nothing():
    sliver = part((0.1,) * 3, (0, 0, 0))
    corner = len(sliver.vertices)
    vertices = np.vstack([sliver.vertices, (sliver.vertices[sliver.faces[0]][:2]).mean(0)])
    a, b, _ = sliver.faces[0]
    flat = Hull(vertices, np.vstack([sliver.faces, [a, corner, b]]))
    assert not flat.face_normals[-1].any()
    _, low, high = overlap(flat, part((0.1,) * 3, (0.09, 0, 0)), GAP)
    assert high - low == pytest.approx(0.01)


def test_a_part_is_cut_below_a_height_and_dropped_above_it():
    cube = part((0.1,) * 3, (0, 0, 0))
    up = np.array([0.0, 0.0, 1.0])
    assert below(cube, up, 0.06) is cube
    assert below(cube, up, -0.06) is None
    assert below(cube, up, 0.02).volume == pytest.approx(0.01 * 0.07)
