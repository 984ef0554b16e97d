"""Tunnels that no ray passed are closed; those that rays passed stay; everything else stays as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from conftest import Shape, make_tabletop
from scipy import ndimage

from perception.observing import observe
from reconstruction.surface import unseen_walls
from reconstruction.surface.closed_solid import ClosedSolid
from reconstruction.surface.profile_depth import EMPTY
from reconstruction.surface.round_body import RoundBody
from reconstruction.surface.seen_surface import SeenSurface
from reconstruction.surface.tunnels import in_one_piece, membranes
from reconstruction.surface.unseen_walls import NEAR, with_unseen_walls

SHAPE = (24, 24, 20)


def genus(solid: np.ndarray) -> int:
    found = ClosedSolid.of(np.where(solid, 1.0, -1.0).astype(np.float32), 0.05)
    assert found is not None
    mesh = trimesh.Trimesh(*found.surface(), process=False)
    assert mesh.is_watertight
    assert found.has_tunnel == (mesh.euler_number < 2)
    return 1 - mesh.euler_number // 2


def cup(bottom: bool) -> np.ndarray:
    """A cup with walls two nodes thick, with or without its bottom."""
    x, y, z = np.indices(SHAPE)
    radius = np.hypot(x - 11.5, y - 11.5)
    solid = (radius < 9) & (z >= 3) & (z < 16)
    return solid & ~((radius < 7) & (z >= (5 if bottom else 0)))


def within(solid: np.ndarray) -> np.ndarray:
    """The empty nodes beside a solid that are not on the lattice's border."""
    loose = ~solid
    for axis in range(3):
        np.moveaxis(loose, axis, 0)[[0, -1]] = False
    return loose


def test_a_bottom_that_nobody_saw_is_closed_and_the_cavity_stays_open() -> None:
    solid = cup(bottom=False)
    loose = within(solid)
    loose[:, :, 9:] = False  # rays came in from above
    wall = membranes(solid, loose, np.zeros(SHAPE))
    assert genus(solid) == 1
    assert genus(solid | wall) == 0
    assert not (wall & ~loose).any()
    # One node thick, as wide as the cavity.
    assert np.pi * 6**2 < wall.sum() < 2 * np.pi * 7.5**2


def test_the_wall_is_where_it_is_likeliest() -> None:
    solid = cup(bottom=False)
    loose = within(solid)
    loose[:, :, 12:] = False
    odds = np.full(SHAPE, -3.0)
    odds[:, :, 6] = -0.5
    wall = membranes(solid, loose, odds)
    assert (np.nonzero(wall)[2] == 6).all()


def test_a_tunnel_that_rays_passed_stays() -> None:
    solid = cup(bottom=False)
    loose = within(solid)
    loose[11:13, 11:13] = False  # a ray down to the table
    assert genus(solid | membranes(solid, loose, np.zeros(SHAPE))) == 1


def test_a_solid_without_tunnels_and_parts_apart_stay_as_they_are() -> None:
    solid = cup(bottom=True)
    assert genus(solid) == 0
    assert not membranes(solid, within(solid), np.zeros(SHAPE)).any()
    solid[20:23, 20:23, 16:19] = True
    assert not membranes(solid, within(solid), np.zeros(SHAPE)).any()


def shell_with_holes(width: int) -> tuple[tuple, np.ndarray]:
    """What with_unseen_walls is given of a ball's shell with two holes, so many nodes wide, through its far
    wall, which no ray reached; and the holes' nodes."""
    observation = observe(make_tabletop((Shape("sphere", (0.05,), (0.0, 0.0, 0.05)),)).frame)
    edges, spacing = SeenSurface.of(observation).edges(0), 0.0025
    item = observation.objects[0]
    eye = edges.behind(item.points, 1.0).mean(0) - item.points.mean(0)
    middle = item.points.mean(0) + 0.05 * eye / np.linalg.norm(eye)
    middle[2] = 0.05
    corner = middle - 0.06
    nodes = corner + spacing * np.moveaxis(np.indices((49, 49, 49)), 0, -1)
    out = np.linalg.norm(nodes - middle, axis=-1)
    shell = 1e3 * np.minimum(0.045 - out, out - 0.039).astype(np.float32)
    away, rise = (nodes - middle) @ (eye / np.linalg.norm(eye)), nodes[..., 2] - middle[2]
    holes = np.zeros(shell.shape, bool)
    aside = np.cross(eye / np.linalg.norm(eye), [0, 0, 1])
    for side in (-0.02, 0.02):
        across = np.abs((nodes - middle) @ aside - side)
        holes |= (np.maximum(across, np.abs(rise)) < spacing * width / 2) & (away > 0) & (shell > -4)
    shell[holes] = -1.0
    return (shell, corner, spacing, edges, item.points), holes


@pytest.mark.parametrize(
    ("width", "narrow", "closed"), [(2, True, True), (12, True, False), (12, False, True)]
)
def test_slips_of_the_lattice_are_closed_where_the_wall_is(width: int, narrow: bool, closed: bool) -> None:
    given, holes = shell_with_holes(width)
    walled = with_unseen_walls(*given, narrow)
    if not closed:
        assert walled is None
    else:
        assert walled is not None
        found, before = ClosedSolid.of(walled, 0.05), ClosedSolid.of(given[0], 0.05)
        assert found is not None
        assert before is not None
        assert before.has_tunnel
        assert not found.has_tunnel
        raised = (walled > 0) & (given[0] <= 0)
        assert 0 < raised.sum() <= holes.sum() + 8 * NEAR * width


@pytest.mark.parametrize(("width", "closed"), [(4, True), (12, False)])
def test_of_many_hidden_nodes_those_beside_the_object_are_looked_at(
    width: int, closed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(unseen_walls, "MOST_HIDDEN", 12_000)
    walled = with_unseen_walls(*shell_with_holes(width)[0])
    assert (walled is not None) == closed
    assert walled is None or genus(walled > 0) == 0


def test_what_lies_in_a_vessel_does_not_open_its_floor() -> None:
    """A tube in the shadow of a ball that is farther away than the nearest that is seen of the tube's object:
    of a vessel, rays ended on the ball and did not pass the floor."""
    near = Shape("box", (0.03, 0.05, 0.04), (-0.15, 0.0, 0.02))
    ball = Shape("sphere", (0.06,), (0.1, 0.0, 0.06))
    observation = observe(make_tabletop((near, ball)).frame)
    own, other = sorted(range(2), key=lambda index: observation.objects[index].label)
    edges = SeenSurface.of(observation).edges(own)
    tube = np.where(cup(bottom=False), 2.0, -2.0).astype(np.float32)
    corner = edges.behind(observation.objects[other].points, 0.06).mean(0) - 0.0025 * np.array(SHAPE) / 2
    given = tube, corner, 0.0025, edges, observation.objects[own].points
    middle = corner[:2] + 0.0025 * 11.5
    vessel = RoundBody(np.eye(3, dtype=np.float32), middle, corner[2], np.full((12, 40), 0.001, np.float32))
    walled = with_unseen_walls(*given, vessel=vessel)
    assert walled is not None
    assert genus(tube > 0) == 1
    assert genus(walled > 0) == 0
    # Of another thing, or beside the vessel, it may be seen through a handle.
    beside = replace(vessel, table=np.full((12, 40), EMPTY, np.float32))
    assert with_unseen_walls(*given) is None
    assert with_unseen_walls(*given, vessel=beside) is None


@pytest.mark.parametrize("seed", range(3))
def test_pieces_are_counted_as_scipy_counts_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    around = rng.random((300, 3, 3, 3)) < rng.uniform(0.1, 0.6)
    around[:, 1, 1, 1] = False
    bits = (np.arange(3)[:, None, None] * 16 + np.arange(3)[:, None] * 4 + np.arange(3)).astype(np.uint64)
    words = (around.astype(np.uint64) << bits).sum((1, 2, 3), dtype=np.uint64)
    pieces = [ndimage.label(item, np.ones((3, 3, 3)))[1] for item in around]
    np.testing.assert_array_equal([in_one_piece(word) for word in words], np.array(pieces) == 1)


def test_random_solids_lose_all_tunnels_through_hidden_space() -> None:
    rng = np.random.default_rng(0)
    noise = ndimage.gaussian_filter(rng.normal(size=SHAPE), 1.5)
    solid = np.zeros(SHAPE, bool)
    solid[2:-2, 2:-2, 2:-2] = noise[2:-2, 2:-2, 2:-2] > 0
    whole = solid | within(solid)
    closed = solid | membranes(solid, within(solid), noise)
    assert genus(solid) > 5
    assert genus(whole) == 0
    # With everything hidden, empty space is one piece without loops, whatever the solid's parts.
    assert genus(closed) <= 0


def test_surfaces_do_not_intersect_themselves() -> None:
    import open3d

    noise = ndimage.gaussian_filter(np.random.default_rng(1).normal(size=(10, 10, 10)), 1.0).astype(
        np.float32
    )
    found = ClosedSolid.of(noise, 0.0)
    assert found is not None
    vertices, faces = found.surface()
    mesh = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(vertices), open3d.utility.Vector3iVector(faces)
    )
    assert len(faces) > 300
    assert not mesh.is_self_intersecting()
