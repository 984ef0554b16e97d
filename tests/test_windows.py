"""Fields and meshes of single objects: hollows, thin plates, empty windows, points outside the lattice."""

import numpy as np
import pytest
from solids import reconstructed_tabletop

from reconstruction.config import MeshConfig


@pytest.fixture(scope="module")
def result():
    return reconstructed_tabletop()


def field_of(log_odds: np.ndarray):
    """A field of one object on a 5 mm lattice, nowhere uncertain."""
    from reconstruction.surface.field import Field

    everywhere = tuple(slice(0, n) for n in log_odds.shape)
    return Field(np.zeros(3), 0.005, [everywhere], [log_odds], np.zeros(log_odds.shape, np.float32))


def test_an_enclosed_hollow_is_filled():
    from reconstruction.surface.meshing import extract_mesh

    axis = np.arange(-20, 21)
    radius = np.sqrt(sum(c**2 for c in np.meshgrid(axis, axis, axis, indexing="ij")))
    shell = np.minimum(15 - radius, radius - 6).astype(np.float32)  # positive between radius 6 and 15
    field = field_of(shell)
    extracted = extract_mesh(field, 0, MeshConfig())
    assert extracted is not None
    mesh, _ = extracted
    assert mesh.is_watertight
    assert mesh.body_count == 1
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * (15 * 0.005) ** 3, rel=0.02)


def plate(thickness: float, height: float):
    """Log odds of a plate 0.1 m wide on a 5 mm lattice, and the points of its upper side."""
    axis = 0.005 * np.arange(41)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    inside = np.minimum(0.05 - np.maximum(abs(x - 0.1), abs(y - 0.1)), thickness / 2 - abs(z - height))
    odds = np.clip(1000 * inside, -3, 3).astype(np.float32)
    field = field_of(odds)
    across = np.arange(0.051, 0.15, 0.002)
    top = np.stack(np.meshgrid(across, across, [height + thickness / 2], indexing="ij"), -1).reshape(-1, 3)
    return field, top


def test_a_thing_thinner_than_a_cell_stays_whole():
    from reconstruction.surface.meshing import extract_mesh

    field, top = plate(thickness=0.002, height=0.0525)  # between the nodes at 50 and 55 mm
    assert extract_mesh(field, 0, MeshConfig()) is None
    assert extract_mesh(field, 0, MeshConfig(keep_seen=False), top) is None
    extracted = extract_mesh(field, 0, MeshConfig(), top)
    assert extracted is not None
    mesh, _ = extracted
    assert mesh.is_watertight
    assert mesh.body_count == 1
    assert np.abs(mesh.extents[:2] - 0.1).max() < 0.01
    assert mesh.extents[2] < 0.01


def test_a_seen_point_where_the_map_rules_an_object_out_leaves_no_trace():
    from reconstruction.surface.meshing import extract_mesh

    field, _ = plate(thickness=0.012, height=0.05)
    field.log_odds[0][field.log_odds[0] < -2] = -9
    astray = np.array([[0.02, 0.02, 0.1]])
    without, _ = extract_mesh(field, 0, MeshConfig())
    with_stray, _ = extract_mesh(field, 0, MeshConfig(), astray)
    assert np.array_equal(without.vertices, with_stray.vertices)


@pytest.mark.parametrize("shape", [(0, 0, 0), (1, 5, 5)])
def test_an_object_that_the_map_finds_nowhere_is_no_error(shape):
    from reconstruction.surface.meshing import extract_mesh

    field = field_of(np.full(shape, -9, np.float32))
    assert extract_mesh(field, 0, MeshConfig(), np.full((3, 3), 0.001)) is None


def test_an_object_in_empty_air_has_an_empty_window(result):
    from reconstruction.fitted_scene import object_space
    from reconstruction.surface.field import evaluate_field
    from reconstruction.surface.meshing import extract_mesh

    lows, highs = object_space(result.observation, 0.1)
    free = result.samples[result.sample_classes == 0]
    air = free[free[:, 2].argmax()]  # a place that rays have passed through
    lows[0], highs[0] = air - 0.01, air + 0.01
    field = evaluate_field(result.map, lows, highs, 0.005)
    assert extract_mesh(field, 0, MeshConfig(), air[None]) is None
    assert extract_mesh(field, 1, MeshConfig(), result.observation.objects[1].points) is not None


def test_points_outside_the_lattice_are_no_error():
    from reconstruction.surface.meshing import extract_mesh

    field, _ = plate(thickness=0.012, height=0.05)
    assert extract_mesh(field, 0, MeshConfig(), np.full((3, 3), 9.0)) is not None


def test_windows_hold_all_that_the_map_gives_an_object(result):
    from reconstruction.fitted_scene import object_space
    from reconstruction.surface.field import OUTSIDE, evaluate_field

    spacing = 0.005
    lows, highs = object_space(result.observation, 0.1)
    field = evaluate_field(result.map, lows, highs, spacing)
    axes = [o + spacing * np.arange(n) for o, n in zip(field.origin, field.uncertainty.shape)]
    probability = result.map.predict_lattice(tuple(axes))
    structure = probability[..., :-1] / probability[..., :-1].sum(-1, keepdims=True)
    for index, (low, high) in enumerate(zip(lows, highs)):
        inside = structure[..., index + 1] > 0.5
        for axis, along in enumerate(axes):
            beyond = (along < low[axis]) | (along > high[axis])
            np.moveaxis(inside, axis, 0)[beyond] = False
        window = field.windows[index]
        assert inside[window].sum() == inside.sum() > 0
        p = structure[(*window, index + 1)]
        sure = (field.log_odds[index] > 0) != (p > 0.5)
        assert np.abs(p[sure] - 0.5).max(initial=0) < 0.02  # others' small parts are left out of a block
        looked_at = field.log_odds[index] > OUTSIDE
        assert looked_at[p > 0.05].all()
        uncertain = probability[(*window, -1)][looked_at]
        np.testing.assert_allclose(field.uncertainty[window][looked_at], uncertain, atol=0.02)
