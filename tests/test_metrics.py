"""Metrics on shapes whose values are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from mapping.errors import DataError
from reconstruction import metrics
from reconstruction.solid import Solid


def cube(side: float = 0.1, shift: tuple[float, float, float] = (0, 0, 0)) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(extents=[side] * 3)
    mesh.apply_translation(shift)
    return mesh


def sheet(z: float, side: float = 0.2) -> trimesh.Trimesh:
    half = side / 2
    corners = [[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize("shift", [0.0, 0.02, 0.05, 0.12])
def test_iou_of_shifted_cubes(shift: float) -> None:
    points = metrics.grid_around(np.array([0.05, 0, 0]), 0.3, 0.005) + 0.0013  # off the cubes' faces
    predicted = metrics.inside(cube(shift=(shift, 0, 0)), points)
    overlap = max(0.0, 0.1 - shift)
    assert metrics.iou_on_grid(predicted, cube(), points) == pytest.approx(
        overlap / (0.2 - overlap), abs=0.03
    )


def test_iou_of_nothing() -> None:
    nothing, something = np.zeros(5, bool), np.array([1, 0, 0, 0, 0], bool)
    assert metrics.iou(nothing, nothing) == 1.0
    assert metrics.iou(nothing, something) == 0.0
    with pytest.raises(DataError, match="shape"):
        metrics.iou(nothing, np.zeros(4, bool))


def test_grid_around_is_centred_and_spaced() -> None:
    grid = metrics.grid_around(np.array([1.0, 2.0, 3.0]), 0.4, 0.015)
    np.testing.assert_allclose(grid.reshape(-1, 3).mean(axis=0), [1, 2, 3])
    np.testing.assert_allclose(np.diff(grid[:, 0, 0, 0]), 0.015)
    assert abs(np.ptp(grid[..., 2]) - 0.4) < 0.015


def test_inside_knows_hollows() -> None:
    shell = cube(0.1)
    core = cube(0.06)
    core.invert()
    hollow = trimesh.util.concatenate([shell, core])
    points = np.array([[0, 0, 0], [0.04, 0.001, 0.002], [0.06, 0, 0]])
    assert metrics.inside(hollow, points).tolist() == [False, True, False]


def test_a_solid_answers_as_its_mesh_does_within_and_beyond_its_box() -> None:
    solid = Solid(cube())
    points = np.random.default_rng(0).uniform(-0.2, 0.2, (4, 500, 3))
    np.testing.assert_array_equal(solid.inside(points), (np.abs(points) < 0.05).all(-1))
    assert not solid.inside(points + 1).any()
    outward = np.linalg.norm(np.maximum(np.abs(points) - 0.05, 0), axis=-1)
    beyond = ~solid.inside(points)
    np.testing.assert_allclose(solid.distance(points)[beyond], outward[beyond], atol=1e-6)


def test_distances_serve_chamfer_and_fscore() -> None:
    a, b = np.random.default_rng(0).random((2, 300, 3))
    distances = metrics.mutual_distances(a, b)
    assert metrics.chamfer_of_distances(distances) == metrics.chamfer_of_points(a, b)
    assert metrics.fscore_of_distances(distances, 0.1) == metrics.fscore_of_points(a, b, 0.1)


@pytest.mark.parametrize("gap", [0.002, 0.01])
def test_chamfer_of_parallel_sheets_is_twice_the_gap(gap: float) -> None:
    rng = np.random.default_rng(0)
    value = metrics.chamfer(sheet(0), sheet(gap), rng, samples=40_000)
    # Samples do not lie opposite each other: with density n the floor is about 0.5 / sqrt(n).
    assert 2 * gap <= value < 2 * gap + 0.0012


def test_chamfer_is_symmetric_and_unsquared() -> None:
    a, b = np.array([[0.0, 0, 0]]), np.array([[0.03, 0, 0], [0, 0.05, 0]])
    assert metrics.chamfer_of_points(a, b) == pytest.approx(0.03 + 0.04)
    assert metrics.chamfer_of_points(b, a) == pytest.approx(0.03 + 0.04)


def test_chamfer_scales_with_the_shapes() -> None:
    small = metrics.chamfer(cube(0.1), cube(0.12), np.random.default_rng(1))
    large = metrics.chamfer(cube(0.2), cube(0.24), np.random.default_rng(1))
    assert large == pytest.approx(2 * small, rel=1e-6)


def test_fscore_steps_from_one_to_zero_at_the_gap() -> None:
    rng = np.random.default_rng(0)
    assert metrics.fscore(sheet(0), sheet(0.004), 0.005, rng) > 0.95
    assert metrics.fscore(sheet(0), sheet(0.006), 0.005, rng) == 0.0


def test_fscore_is_the_harmonic_mean_of_precision_and_recall() -> None:
    predicted = np.array([[0.0, 0, 0], [1, 0, 0]])  # half of it right
    true = np.array([[0.0, 0, 0]])  # all of it found
    assert metrics.fscore_of_points(predicted, true, 0.01) == pytest.approx(2 / 3)


def test_samples_are_uniform_on_the_surface() -> None:
    mesh = trimesh.creation.box(extents=[0.3, 0.1, 0.1])
    points = metrics.sample_surface(mesh, 20_000, np.random.default_rng(0))
    assert metrics.distance_to_surface(mesh, points).max() < 1e-6
    ends = np.abs(np.abs(points[:, 0]) - 0.15) < 1e-9
    assert ends.mean() == pytest.approx(0.02 / 0.14, abs=0.01)


def test_visible_and_hidden_parts_are_told_apart() -> None:
    true, predicted = cube(0.1), cube(0.1, (0, 0, 0.01))
    front = metrics.sample_surface(true, 20_000, np.random.default_rng(3))
    front = front[front[:, 2] > 0.0499]  # the camera saw the top alone
    errors = metrics.hidden_and_visible_error(predicted, true, front, np.random.default_rng(4))
    assert errors["visible"] > 0.005  # the top moved by 1 cm
    assert errors["hidden"] < errors["visible"]  # most of the sides slid along themselves
    none = metrics.hidden_and_visible_error(predicted, true, np.zeros((0, 3)), np.random.default_rng(4))
    assert np.isnan(none["visible"])


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.zeros((4, 2))])
def test_points_of_a_wrong_shape_are_refused(points: np.ndarray) -> None:
    with pytest.raises(DataError, match=r"\(N, 3\)"):
        metrics.chamfer_of_points(points, np.zeros((1, 3)))


def test_empty_mesh_is_refused() -> None:
    with pytest.raises(DataError, match="no triangles"):
        metrics.chamfer(trimesh.Trimesh(), cube(), np.random.default_rng(0))
