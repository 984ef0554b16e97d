"""Distance queries against exact distances, and inflated shapes: nested, closed, and around the object."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh
from planner_scene import PlannerScene, bracket, planner_scene
from solids import reconstructed_tabletop

from mapping.errors import ConfigError, DataError
from perception.camera import transform
from reconstruction.distance import DistanceField
from reconstruction.files.result_folder import load_result, save_reconstruction
from reconstruction.inflate import inflated_meshes
from reconstruction.solid import Solid


@pytest.fixture(scope="module")
def planned(tmp_path_factory) -> PlannerScene:
    return planner_scene(tmp_path_factory.mktemp("result"))


def exact(meshes, points: np.ndarray) -> np.ndarray:
    far = np.min([Solid(mesh).distance(points) for mesh in meshes], axis=0)
    inside = np.any([Solid(mesh).inside(points) for mesh in meshes], axis=0)
    return np.where(inside, -far, far)


def around(meshes, count: int, margin: float) -> np.ndarray:
    low = np.min([mesh.bounds[0] for mesh in meshes], axis=0) - margin
    high = np.max([mesh.bounds[1] for mesh in meshes], axis=0) + margin
    return np.random.default_rng(0).uniform(low, high, (count, 3))


def test_distances_of_a_reconstruction_are_those_of_its_meshes():
    reconstruction = reconstructed_tabletop()
    meshes = [item.mesh for item in reconstruction.objects]
    points = around(meshes, 5000, 0.05)
    found = reconstruction.distance(points)
    true = exact(meshes, points)
    assert np.median(np.abs(found.distance - true)) < 1e-3
    assert np.quantile(np.abs(found.distance - true), 0.99) < 4e-3
    assert (found.distance < 0)[np.abs(true) > 2e-3].tolist() == (true < 0)[np.abs(true) > 2e-3].tolist()
    assert 0.02 < found.unknown.mean() < 0.9


def test_one_object_alone():
    reconstruction = reconstructed_tabletop()
    item = reconstruction.objects[1]
    points = around([item.mesh], 2000, 0.05)
    found = reconstruction.distance(points, item.label)
    assert np.median(np.abs(found.distance - exact([item.mesh], points))) < 1e-3
    with pytest.raises(ConfigError, match="no object has label 77"):
        reconstruction.distance(points, 77)


def test_gradient_leads_to_the_surface():
    ball = trimesh.creation.icosphere(4, 0.05)
    ball.apply_translation([0.3, -0.2, 0.7])
    T = trimesh.transformations.euler_matrix(0.3, 0.8, -0.5)
    T[:3, 3] = [1.0, 2.0, 3.0]
    field = DistanceField([ball], T, None)
    points = around([ball], 3000, 0.25)  # beyond the lattice as well
    found = field(points)
    away = points - [0.3, -0.2, 0.7]
    true = np.linalg.norm(away, axis=1)
    assert np.median(np.abs(found.distance - (true - 0.05))) < 1e-3
    aligned = np.einsum("ij,ij->i", found.gradient, away) / true
    assert np.median(aligned) > 0.995
    assert aligned[true > 0.02].min() > 0.9
    assert not found.unknown[true < 0.14].any()  # no map: known, as far as the lattice reaches
    assert found.unknown[np.abs(away).max(1) > 0.3].all()


def test_unknown_is_what_the_map_does_not_know(planned):
    result = planned.result
    local = np.array([[0.0, 0.14, 0.1], [-0.08, -0.12, 0.1], [0.0, 0.0, 5.0]])
    found = result.distance(transform(result.T_world_table, local))
    assert found.unknown.tolist() == [True, False, True]


def test_a_field_does_not_depend_on_where_the_world_is(planned):
    far = np.eye(4)
    far[:3, 3] = [4e5, -5e6, 120.0]
    meshes = list(planned.meshes.values())
    moved = [trimesh.Trimesh(mesh.vertices + far[:3, 3], mesh.faces, process=False) for mesh in meshes]
    points = around(meshes, 500, 0.05)
    here = DistanceField(meshes, planned.result.T_world_table, None)(points)
    there = DistanceField(moved, far @ planned.result.T_world_table, None)(points + far[:3, 3])
    # Nodes lie elsewhere in cells by rounding; values between them may differ a little.
    assert there.distance == pytest.approx(here.distance, abs=2e-3)


@pytest.mark.parametrize("points", [np.zeros(3), np.zeros((2, 2)), np.full((1, 3), np.nan)])
def test_odd_points_are_refused(planned, points):
    with pytest.raises(DataError, match="points"):
        planned.result.distance(points)


def test_stored_results_answer_alike(tmp_path):
    reconstruction = reconstructed_tabletop()
    stored = load_result(save_reconstruction(reconstruction, tmp_path / "result"))
    points = around([item.mesh for item in reconstruction.objects], 3000, 0.05)
    here, there = reconstruction.distance(points), stored.distance(points)
    assert there.distance == pytest.approx(here.distance, abs=3e-3)
    assert (here.unknown == there.unknown).mean() > 0.99


def test_inflated_meshes_are_closed_nested_and_hold_the_object(tmp_path):
    reconstruction = reconstructed_tabletop()
    stored = load_result(save_reconstruction(reconstruction, tmp_path / "result"))
    wide, narrow = (inflated_meshes(stored, p) for p in (0.05, 0.3))
    for item in stored.objects:
        for mesh in (wide[item.label], narrow[item.label]):
            assert mesh.is_watertight
            assert mesh.is_winding_consistent
        assert item.mesh.volume * 0.99 < narrow[item.label].volume <= wide[item.label].volume
        sticking_out = ~Solid(wide[item.label]).inside(np.asarray(item.mesh.vertices))
        if sticking_out.any():
            distance = Solid(wide[item.label]).distance(np.asarray(item.mesh.vertices)[sticking_out])
            assert distance.max() < 3e-4
    assert wide[1].volume > 1.02 * stored.objects[0].mesh.volume
    with pytest.raises(ConfigError):
        inflated_meshes(stored, 1.0)


@pytest.mark.slow
def test_inflate_reaches_collisions_and_leaves_the_visible_mesh(tmp_path):
    stored = load_result(save_reconstruction(reconstructed_tabletop(), tmp_path / "result"))
    from reconstruction.export.export_scene import ExportConfig, ExportScene

    plain, wide = ExportScene(stored), ExportScene(stored, ExportConfig(inflate=0.05))
    for a, b in zip(plain.objects, wide.objects, strict=True):
        assert a.solid is a.mesh
        assert b.solid.volume > a.solid.volume
        assert (b.mesh.vertices == a.mesh.vertices).all()


def test_objects_that_overlap_count_as_one():
    box = bracket()
    other = box.copy()
    other.apply_translation([0.01, 0.005, 0.0])
    points = around([box, other], 3000, 0.03)
    found = DistanceField([box, other], np.eye(4), None)(points)
    inside = Solid(box).inside(points) | Solid(other).inside(points)
    sure = np.abs(found.distance) > 2e-3
    assert ((found.distance < 0) == inside)[sure].all()


def test_frozen_results_stay_replaceable():
    reconstruction = reconstructed_tabletop()
    assert dataclasses.replace(reconstruction, seed=1).seed == 1
