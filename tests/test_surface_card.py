"""Agreement with the depth image and the surface card, on shapes whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from perception.camera import Camera
from reconstruction.solid import Solid
from reconstruction.surface.agreement import Agreement, agreement_with_depth, depth_of_mesh
from tools.evaluation.handles import handles_and_parts, true_handles
from tools.evaluation.surface_card import excess_across, normal_error, wall_excess

CAMERA = Camera(np.array([[200.0, 0, 80], [0, 200.0, 60], [0, 0, 1]]), 160, 120)


def ball(radius: float = 0.05, centre: tuple[float, float, float] = (0, 0, 0.5)) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    mesh.apply_translation(centre)
    return mesh


def view(mesh: trimesh.Trimesh, background: float = 0.8) -> tuple[np.ndarray, np.ndarray]:
    """Labels and depth (H, W) of a mesh before a wall."""
    part, met = depth_of_mesh(mesh, CAMERA, np.eye(4))
    depth = np.full((CAMERA.height, CAMERA.width), background, np.float32)
    depth[part] = np.minimum(depth[part], met)
    return (depth < background).astype(np.uint16), depth


def agreement(mesh: trimesh.Trimesh, labels: np.ndarray, depth: np.ndarray) -> Agreement:
    return agreement_with_depth({1: mesh}, labels, depth, CAMERA, np.eye(4))[1]


def test_the_true_mesh_agrees_everywhere() -> None:
    found = agreement(ball(), *view(ball()))
    assert found.agreement == 1
    assert found.early_rays == 0
    assert not found.contradicts


def test_a_mesh_before_its_surface_stops_rays_early() -> None:
    labels, depth = view(ball())
    found = agreement(ball(centre=(0, 0, 0.48)), labels, depth)
    assert found.agreement < 0.1
    assert found.early_rays > 0.9
    assert found.contradicts


def test_a_mesh_too_large_agrees_but_stops_rays_beside_it() -> None:
    def box(width: float) -> trimesh.Trimesh:
        mesh = trimesh.creation.box((width, 0.08, 0.02))
        mesh.apply_translation((0.0003, 0.0003, 0.5))
        return mesh

    grown = agreement(box(0.12), *view(box(0.08)))
    assert grown.agreement == 1
    assert grown.early_rays == pytest.approx(0.5, abs=0.1)


def test_pixels_without_depth_are_not_counted() -> None:
    labels, depth = view(ball())
    depth[:, :80] = np.nan
    found = agreement(ball(), labels, depth)
    assert found.pixels == (labels[:, 80:] > 0).sum()
    assert found.agreement == 1
    assert np.isnan(agreement(ball(), labels * 0, depth).agreement)


def test_handles_and_parts() -> None:
    ring = trimesh.creation.torus(0.04, 0.01)
    assert handles_and_parts(ball()) == (0, 1)
    assert handles_and_parts(ring) == (1, 1)
    assert handles_and_parts(trimesh.util.concatenate([ring, ball()])) == (1, 2)
    open_mesh = trimesh.Trimesh(ring.vertices, ring.faces[1:], process=False)
    assert handles_and_parts(open_mesh) == (None, 1)


def test_normals_of_a_turned_plane_are_off_by_its_angle() -> None:
    rng = np.random.default_rng(0)
    box = trimesh.creation.box((0.2, 0.2, 0.01))
    turned = box.copy()
    turned.apply_transform(trimesh.transformations.rotation_matrix(np.radians(5), (1, 0, 0)))
    middle = np.column_stack([rng.uniform(-0.01, 0.01, (500, 2)), np.full(500, 0.005)])
    assert normal_error(box, box, middle, rng) == pytest.approx(0, abs=0.5)
    assert normal_error(turned, box, middle, rng) == pytest.approx(5, abs=0.5)
    assert normal_error(box, box, middle + 1, rng) is None


def test_walls_are_measured_along_rays() -> None:
    rng = np.random.default_rng(0)
    thin, thick = trimesh.creation.box((0.2, 0.2, 0.004)), trimesh.creation.box((0.2, 0.2, 0.007))
    seen = np.column_stack([rng.uniform(-0.05, 0.05, (500, 2)), np.full(500, 0.002)])
    found = wall_excess(Solid(thick), Solid(thin), seen, np.array([0, 0, 1.0]), rng)
    assert found["wall_excess_mm"] == pytest.approx(3, abs=0.1)
    assert found["wall_share"] == 1
    solid = trimesh.creation.box((0.2, 0.2, 0.1))
    assert wall_excess(Solid(thin), Solid(solid), seen, np.array([0, 0, 1.0]), rng)["wall_excess_mm"] is None


def test_walls_across_are_not_longer_where_rays_graze_them() -> None:
    rng = np.random.default_rng(0)
    thin, thick = trimesh.creation.box((0.2, 0.2, 0.004)), trimesh.creation.box((0.2, 0.2, 0.008))
    thick.apply_translation([0, 0, -0.002])
    seen = np.column_stack([rng.uniform(-0.05, 0.05, (500, 2)), np.full(500, 0.002)])
    slanted = wall_excess(Solid(thick), Solid(thin), seen, np.array([3.0, 0, 2.0]), rng)["wall_excess_mm"]
    assert slanted is not None
    assert slanted > 6
    assert excess_across(Solid(thick), Solid(thin), seen, rng) == pytest.approx(4, abs=0.1)
    assert excess_across(Solid(thin), Solid(trimesh.creation.box((0.2, 0.2, 0.1))), seen, rng) is None


@pytest.mark.parametrize(("hole", "handles"), [(0.0008, 0), (0.012, 1)])
def test_a_pinhole_is_no_handle(hole: float, handles: int) -> None:
    disc = trimesh.creation.annulus(hole, 0.03, 0.01)
    assert handles_and_parts(disc) == (1, 1)
    assert true_handles(Solid(disc)) == handles
