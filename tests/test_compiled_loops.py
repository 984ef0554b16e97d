"""Compiled loops against the libraries they stand in for, and the folder they are kept in."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from mapping.compiled import compiled
from reconstruction.surface.field import extent
from reconstruction.surface.fusion import places
from reconstruction.surface.isosurface import crossed_cells, isosurface
from reconstruction.surface.neighbours import nodes_off, smoothed
from reconstruction.surface.parts import drop, label
from reconstruction.surface.refined import values_at

SHAPES = [(3, 4, 5), (1, 7, 2), (12, 9, 17)]


def lattice(shape: tuple[int, ...], smooth: float, seed: int) -> np.ndarray:
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=shape), smooth)
    return np.pad(noise, 1, constant_values=-8).astype(np.float32)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("smooth", [0.0, 0.7, 1.5])
def test_parts_and_voids_are_those_that_scipy_finds(shape: tuple[int, ...], smooth: float) -> None:
    values = lattice(shape, smooth, 3)
    outside, _ = ndimage.label(values <= 0)
    void = (outside > 0) & (outside != outside[0, 0, 0])
    filled = values.copy()
    filled[void] = np.maximum(-filled[void], 0.01)
    expected, count = ndimage.label(filled > 0)
    parts = label(values)
    np.testing.assert_array_equal(values, filled)
    assert parts.sizes.tolist() == [0, *(int((expected == k).sum()) for k in range(1, count + 1))]
    for number in range(1, min(count, 9) + 1):
        alone = values.copy()
        drop(alone, parts, np.array([number]))
        np.testing.assert_array_equal(
            alone, np.where((values > 0) & (expected != number), np.float32(-0.01), values)
        )


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("share", [0.02, 0.4])
def test_steps_from_a_solid_are_scipys_chessboard_distance(shape: tuple[int, ...], share: float) -> None:
    solid = np.random.default_rng(1).random(shape) < share
    solid[0, 0, 0] = True
    np.testing.assert_array_equal(nodes_off(solid), ndimage.distance_transform_cdt(~solid, "chessboard"))
    assert (nodes_off(np.zeros(shape, bool)) == 255).all()


@pytest.mark.parametrize("smooth", [0.0, 0.7])
def test_surfaces_are_those_that_open3d_finds_to_the_byte(smooth: float) -> None:
    import open3d

    values = 5 * lattice((12, 9, 17), smooth, 4)
    volume = open3d.core.Tensor.from_numpy(values)
    surface = open3d.t.geometry.TriangleMesh.create_isosurfaces(volume, [0.0])
    crossed = crossed_cells(values)
    vertices, faces = isosurface(values, crossed)
    # Open3D counts the axes the other way round, which turns the triangles over.
    np.testing.assert_array_equal(vertices, surface.vertex.positions.numpy()[:, ::-1])
    np.testing.assert_array_equal(faces, surface.triangle.indices.numpy()[:, ::-1])
    assert (crossed.vertices, crossed.triangles) == (len(vertices), len(faces))


def test_the_extent_holds_all_nodes_above_zero() -> None:
    values = np.full((4, 5, 6), -1.0, np.float32)
    assert extent(values) is None
    assert extent(values > 0) is None
    values[1, 2, 3] = values[2, 2, 0] = 1
    expected = (slice(1, 3), slice(2, 3), slice(0, 4))
    assert extent(values) == extent(values > 0) == extent(np.asfortranarray(values)) == expected


@pytest.mark.parametrize("shape", SHAPES)
def test_smoothing_is_scipys_to_the_byte(shape: tuple[int, ...]) -> None:
    values = np.random.default_rng(2).normal(size=shape).astype(np.float32)
    np.testing.assert_array_equal(smoothed(values, 1.0), ndimage.gaussian_filter(values, 1.0))


def test_values_between_nodes_are_those_of_scipy() -> None:
    values = lattice((4, 5, 6), 0.0, 5)
    limit = np.array(values.shape) - 1
    where = np.concatenate(
        [np.random.default_rng(6).uniform(-1, 8, (200, 3)), [limit, limit - 0.25, np.zeros(3)]]
    )
    expected = ndimage.map_coordinates(values, np.clip(where, 0, limit).T, order=1)
    np.testing.assert_array_equal(values_at(values, where), expected)


def test_places_of_nodes_are_their_indices_times_the_spacing() -> None:
    shape, corner = (4, 5, 6), np.array([0.1, -0.2, 0.3])
    nodes = np.array([0, 7, 119])
    expected = corner + 0.01 * np.stack(np.unravel_index(nodes, shape), 1)
    np.testing.assert_allclose(places(nodes, shape, corner, 0.01), expected, atol=1e-6)


def test_without_a_folder_to_write_loops_are_compiled_for_the_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import numba

    made = []
    njit = numba.njit

    def without_cache(function, **settings):
        made.append(settings.get("cache", False))
        if settings.get("cache"):
            raise RuntimeError("cannot cache function: no locator available")
        return njit(function, **settings)

    monkeypatch.setattr(numba, "njit", without_cache)

    def twice(x: int) -> int:
        return 2 * x

    assert compiled(twice)(3) == 6
    assert made == [True, False]
