"""Tunnels that no ray passed are closed; those that rays passed stay; everything else stays as it is."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy import ndimage

from reconstruction.surface.closed_solid import ClosedSolid
from reconstruction.surface.tunnels import in_one_piece, membranes

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
