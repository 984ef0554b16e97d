"""What was measured stays where it was measured: planes of the depth image, distances, the fused surface."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from conftest import Shape, make_tabletop
from scipy import ndimage
from solids import reconstructed_tabletop

from perception.camera import Camera
from perception.observation import Observation
from perception.observing import observe
from reconstruction.config import FusionConfig, MeshConfig, PipelineConfig, preset
from reconstruction.scene import reconstruct
from reconstruction.surface.agreement import agreement_with_depth
from reconstruction.surface.diagonals import between_diagonals
from reconstruction.surface.field import Field, window_of
from reconstruction.surface.meshing import extract_mesh
from reconstruction.surface.neighbours import beside, closed, range_in_cells
from reconstruction.surface.reading import FAR
from reconstruction.surface.refined import interpolated, nodes_of_cells, spread
from reconstruction.surface.seen_cells import cells_with
from reconstruction.surface.seen_surface import SeenSurface
from reconstruction.surface.smooth_depth import surface_planes
from tools.evaluation.handles import handles_and_parts

CAMERA = Camera(np.array([[300.0, 0, 79.5], [0, 300.0, 59.5], [0, 0, 1]]), 160, 120)
TILTED = np.array([0.48, -0.36, 0.8])
"""Normal of a slanted plane."""


def tilted_depth(distance: float = 0.5) -> np.ndarray:
    """Depth (H, W) of the plane TILTED . x = distance."""
    return (distance / (CAMERA.rays @ TILTED)).astype(np.float32)


def planes_of(depth: np.ndarray, labels: np.ndarray | None = None) -> tuple[np.ndarray, float]:
    labels = np.ones(depth.shape, int) if labels is None else labels
    return surface_planes(depth, labels, np.flatnonzero(np.isfinite(depth)), CAMERA)


def test_a_plane_is_found_exactly_at_every_pixel() -> None:
    planes, noise = planes_of(tilted_depth())
    np.testing.assert_allclose(planes, np.tile([*TILTED, 0.5], (planes.shape[0], 1)), atol=1e-3)
    assert noise < 1e-4


def test_noise_is_measured_and_smoothed() -> None:
    sigma = 0.002  # standard deviation of inverse depth [1/m]
    rng = np.random.default_rng(0)
    depth = 1 / (1 / tilted_depth() + sigma * rng.standard_normal((120, 160)))
    planes, noise = planes_of(depth.astype(np.float32))
    assert noise == pytest.approx(sigma, rel=0.1)
    inner = np.zeros((120, 160), bool)
    inner[10:-10, 10:-10] = True
    points = CAMERA.back_project(tilted_depth())[inner]
    error = (planes[inner.ravel(), :3] * points).sum(1) - planes[inner.ravel(), 3]
    raw = (CAMERA.back_project(depth)[inner] - points) @ TILTED
    assert error.std() < 0.5 * raw.std()


def test_edges_are_not_smoothed_away() -> None:
    depth = np.full((120, 160), 0.6, np.float32)
    depth[:, 80:] = 0.5
    depth += 0.0005 * np.random.default_rng(0).standard_normal(depth.shape).astype(np.float32)
    planes, _ = planes_of(depth)
    along = (1 / (planes[:, :3] * CAMERA.rays.reshape(-1, 3)).sum(1) * planes[:, 3]).reshape(depth.shape)
    assert np.abs(along - depth).max() < 0.004


@cache
def box_view() -> Observation:
    """A box on a table, from the front and above."""
    return observe(make_tabletop((Shape("box", (0.08, 0.10, 0.12), (0.0, 0.0, 0.06)),)).frame)


def test_distances_follow_the_rays() -> None:
    observation = box_view()
    edges = SeenSurface.of(observation, floors=[-0.0015]).edges(0)
    item = observation.objects[0]
    origin = SeenSurface.of(observation).T_camera_table
    eye = -origin[:3, :3].T @ origin[:3, 3]
    rays = item.points - eye
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    at, before, behind = (edges.read((item.points + s * rays).astype(np.float32)) for s in (0, -0.01, 0.002))
    assert np.abs(at.distance).max() < 5e-4
    assert (before.distance < 0).mean() > 0.99
    assert (behind.distance > 0).mean() > 0.95
    assert behind.depth.max() < 0.003
    assert (before.depth == FAR).all()
    assert (at.others == FAR).all()
    below = edges.read(np.array([[0.0, 0.0, -0.01]], np.float32))
    assert below.distance[0] == pytest.approx(-0.0085, abs=1e-5)
    unseen = edges.read(np.array([[0.1, 0.0, 0.03]], np.float32))  # behind the box
    assert unseen.distance[0] > 0
    assert unseen.distance[0] <= FAR


def fused_shell(wall: float = 0.004) -> tuple[Observation, object]:
    """The mesh of a box of which the map knows nothing: only what was seen is left of it."""
    observation = box_view()
    item = observation.objects[0]
    low, high = item.bounds[0] - 0.03, item.bounds[1] + 0.03
    shape = tuple(np.ceil((high - low) / 0.005).astype(int) + 1)
    field = Field(low, 0.005, [window_of(low, 0.005, shape, low, high)], [], np.ones(shape, np.float32))
    field = replace(field, log_odds=[np.full(field.uncertainty[field.windows[0]].shape, -5, np.float32)])
    seen = SeenSurface.of(observation, floors=[-0.0015])
    config = MeshConfig(fusion=FusionConfig(wall=wall))
    found = extract_mesh(field, 0, config, item.points, seen)
    assert found is not None
    return observation, found[0]


def test_what_was_seen_is_a_closed_thin_solid_even_if_the_map_denies_it() -> None:
    observation, mesh = fused_shell()
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert handles_and_parts(mesh) == (0, 1)
    T = np.linalg.inv(observation.T_table_camera)
    found = agreement_with_depth({1: mesh}, observation.labels, observation.depth, observation.camera, T)[1]
    assert found.agreement > 0.97
    assert found.early_rays < 0.01
    # Three faces of 8 x 10, 10 x 12 and none behind: a shell of 4 mm.
    seen_area = 0.08 * 0.10 + 0.10 * 0.12
    assert mesh.volume == pytest.approx(seen_area * 0.004, rel=0.4)
    assert fused_shell(0.008)[1].volume > 1.5 * mesh.volume


def test_meshes_of_the_pipeline_agree_with_their_depth_image() -> None:
    result = reconstructed_tabletop()
    for item in result.objects:
        found = result.agreement[item.label]
        assert found.agreement > 0.97, item.name
        assert found.early_rays < 0.01, item.name
        assert item.watertight
    assert result.contradictions == []


def test_without_fusion_the_surface_is_the_map_s() -> None:
    frame = make_tabletop(size=(240, 180)).frame
    config = preset("tabletop", mesh={"fusion": {"enabled": False}})
    plain = reconstruct(frame, config)
    fused = reconstruct(frame, preset("tabletop", mesh={"fusion": {"cuboids": False, "round_bodies": False}}))
    assert np.array_equal(plain.map.W, fused.map.W)
    assert len(plain.objects[0].mesh.faces) < 0.5 * len(fused.objects[0].mesh.faces)
    assert not preset("paper").mesh.fusion.enabled
    assert PipelineConfig().mesh.fusion.enabled


def test_upsampling_is_linear() -> None:
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in (3, 4, 5)), indexing="ij")).astype(np.float32)
    values = 2 * grid[0] - grid[1] + 0.5 * grid[2] + 1
    shape = spread(values, 3).shape
    assert shape == (7, 10, 13)
    nodes = np.arange(np.prod(shape))
    where = np.stack(np.unravel_index(nodes, shape)) / 3
    fine = interpolated(values, 3, nodes)
    np.testing.assert_allclose(fine, 2 * where[0] - where[1] + 0.5 * where[2] + 1, atol=1e-5)
    np.testing.assert_array_equal(spread(values, 3).reshape(-1), values[tuple(where.astype(int))])


@pytest.mark.parametrize("shape", [(7, 5, 6), (2, 9, 3)])
def test_neighbours_on_the_flat_array_are_those_of_the_lattice(shape: tuple[int, int, int]) -> None:
    """Nothing is carried over from one row to the next, on borders either."""
    rng = np.random.default_rng(0)
    nodes, values = rng.random(shape) < 0.2, rng.normal(size=shape).astype(np.float32)
    cube = np.ones((3, 3, 3), bool)
    assert np.array_equal(beside(nodes), ndimage.binary_dilation(nodes, cube))
    assert np.array_equal(closed(values), ndimage.grey_closing(values, 3))
    corners = [
        values[i : shape[0] - 1 + i, j : shape[1] - 1 + j, k : shape[2] - 1 + k]
        for i, j, k in np.ndindex(2, 2, 2)
    ]
    least, greatest = range_in_cells(values)
    assert np.array_equal(least, np.min(corners, axis=0))
    assert np.array_equal(greatest, np.max(corners, axis=0))
    cells, whole = nodes[1:, 1:, 1:], np.ones((3, 3, 3), bool)
    expected = np.zeros([2 * n - 1 for n in shape], bool)
    for i, j, k in np.argwhere(cells):
        expected[2 * i : 2 * i + 3, 2 * j : 2 * j + 3, 2 * k : 2 * k + 3] = whole
    assert np.array_equal(nodes_of_cells(cells, 2), np.flatnonzero(expected))


def test_cells_with_points_are_taken_with_those_across_their_faces() -> None:
    shape, corner = (7, 5, 6), np.array([0.1, -0.2, 0.3])
    points = (corner + np.random.default_rng(0).uniform(-1, 7, (40, 3)) * 0.01).astype(np.float32)
    held = np.zeros([n - 1 for n in shape], bool)
    cell = np.floor((points - corner) / 0.01).astype(int)
    held[tuple(cell[((cell >= 0) & (cell < held.shape)).all(1)].T)] = True
    expected = ndimage.binary_dilation(held, ndimage.generate_binary_structure(3, 1))
    assert np.array_equal(cells_with(points, corner, 0.01, shape), expected)


@pytest.mark.parametrize("normal", [(1, 0, 1), (2, 1, 2), (1, 1, 1), (3, 0, 1)])
def test_joined_diagonals_leave_no_holes_in_an_oblique_sheet(normal: tuple[int, int, int]) -> None:
    """A cell thick it steps from node to node across squares; outside nodes on its two sides never touch."""
    n = np.array(normal) / np.linalg.norm(normal)
    height = np.stack(np.meshgrid(*[np.arange(20.0)] * 3, indexing="ij"), -1) @ n - 19.5 * n.sum() / 2 - 0.13
    values = (np.max(n) / 2 + 0.01 - abs(height)).astype(np.float32)
    sheet = values > 0
    values[between_diagonals(values, -2.0)] = 0.4
    assert (values > 0).sum() > sheet.sum()
    assert ((values > 0) & ~sheet & (abs(height) > 1)).sum() == 0
    above, below = (values <= 0) & (height > 0), (values <= 0) & (height < 0)
    for axes in ((0,), (1,), (2,), (0, 1), (0, 2), (1, 2)):  # neighbours along an axis, or across a square
        offset = np.isin(np.arange(3), axes).astype(int)
        reach = np.zeros((3, 3, 3), bool)
        for signs in np.ndindex(2, 2, 2):
            reach[tuple(1 + offset * (2 * np.array(signs) - 1))] = True
        assert not (ndimage.binary_dilation(above, reach) & below).any()


def test_nodes_far_outside_join_nothing() -> None:
    values = np.full((3, 3, 3), -3.0, np.float32)
    values[0, 0, 0] = values[0, 1, 1] = 1
    assert len(between_diagonals(values, -2.0)[0]) == 0
    values[0, 1, 0] = -1
    np.testing.assert_array_equal(between_diagonals(values, -2.0), [[0], [1], [0]])
