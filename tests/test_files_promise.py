"""What is promised of mesh files is what other programs find in them, in any world frame."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from conftest import make_tabletop
from solids import reconstructed_tabletop

from perception.camera import invert_rigid, transform
from reconstruction import reconstruct
from reconstruction.files.mesh_files import decode_ply, encode_obj, encode_ply, loads_closed
from reconstruction.files.result_folder import load_result, save_reconstruction
from reconstruction.pictures.near_origin import near_origin
from reconstruction.pictures.overview import compose_overview
from reconstruction.surface.vertices_apart import LEAST_GAP, apart, off_the_surface

FAR_AWAY = np.array([691_234.5, 5_334_567.25, 517.125])
"""A place in UTM coordinates [m]."""


def moved(frame, shift: np.ndarray):
    """The same frame with its world's origin at -shift."""
    T = frame.camera.T_world_camera.copy()
    T[:3, 3] += shift
    return dataclasses.replace(frame, camera=dataclasses.replace(frame.camera, T_world_camera=T))


@pytest.fixture(scope="module")
def far():
    return reconstruct(moved(make_tabletop(size=(240, 180)).frame, FAR_AWAY))


def test_files_in_map_coordinates_are_those_near_the_origin(far, tmp_path: Path) -> None:
    near = reconstructed_tabletop()
    folder = save_reconstruction(far, tmp_path / "result")
    entries = json.loads((folder / "scene.json").read_text())["objects"]
    assert len(entries) == len(near.objects)
    for entry, item in zip(entries, near.objects):
        assert entry["watertight"]
        for key in ("mesh", "mesh_obj"):
            mesh = trimesh.load(folder / entry[key])
            assert mesh.is_volume, key
            np.testing.assert_allclose(mesh.bounds - FAR_AWAY, item.mesh.bounds, atol=1e-5)
            assert mesh.volume == pytest.approx(item.mesh.volume, rel=1e-2)
    for stored, item in zip(load_result(folder).objects, near.objects):
        np.testing.assert_allclose(stored.mesh.vertices - FAR_AWAY, item.mesh.vertices, atol=1e-6)


def test_query_in_map_coordinates_answers_as_near_the_origin(far) -> None:
    near = reconstructed_tabletop()
    points = np.concatenate([item.mesh.vertices[::40] for item in near.objects])
    here, there = near.query(points), far.query(points + FAR_AWAY)
    np.testing.assert_allclose(there.occupancy, here.occupancy, atol=2e-3)
    np.testing.assert_allclose(there.uncertainty, here.uncertainty, atol=2e-3)


@pytest.mark.slow
def test_pictures_in_map_coordinates_are_those_near_the_origin(far) -> None:
    shown, truth = near_origin(far, {1: far.objects[0].mesh})
    assert np.abs(shown.T_world_table[:3, 3]).max() < 2
    for before, after in zip(far.objects, shown.objects):
        local = [
            transform(invert_rigid(item.T_world_object), np.asarray(item.mesh.vertices))
            for item in (before, after)
        ]
        np.testing.assert_allclose(*local, atol=1e-6)
    assert truth is not None
    assert (truth[1].vertices == shown.objects[0].mesh.vertices).all()
    here = np.asarray(compose_overview(reconstructed_tabletop()).convert("L"), float)
    there = np.asarray(compose_overview(shown).convert("L"), float)
    assert np.abs(here - there).mean() < 2


def test_every_file_of_a_large_mesh_4000_km_away_is_closed_and_right() -> None:
    ball = trimesh.creation.icosphere(subdivisions=7, radius=0.1)  # 163,842 vertices, 1.4 mm apart
    away = np.array([3_000_000.0, -2_000_000.0, 1_700_000.0])
    mesh = trimesh.Trimesh(ball.vertices + away, ball.faces, process=False)
    uncertainty = np.linspace(0, 1, len(ball.vertices)).astype(np.float32)
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        for name, content in (("mesh.ply", encode_ply(mesh, uncertainty)), ("mesh.obj", encode_obj(mesh))):
            path = Path(folder) / name
            path.write_bytes(content)
            assert loads_closed(path)
            loaded = trimesh.load(path, process=False)
            assert np.abs(np.asarray(loaded.vertices) - away - ball.vertices).max() < 1e-5
        read, values = decode_ply(Path(folder) / "mesh.ply")
    assert (read.vertices == mesh.vertices).all()
    assert (values == uncertainty).all()


def test_an_open_file_of_a_closed_mesh_is_said(tmp_path: Path) -> None:
    """Two vertices a nanometre apart are one for other programs, and a triangle collapses."""
    reconstruction = reconstructed_tabletop()
    item = reconstruction.objects[0]
    vertices = np.array(item.mesh.vertices)
    a, b = item.mesh.faces[0][:2]
    vertices[a] = vertices[a].round(6)  # away from where rounding to 8 digits would part the two
    vertices[b] = vertices[a] + 1e-9
    pinched = trimesh.Trimesh(vertices, item.mesh.faces, process=False)
    assert pinched.is_watertight
    objects = (dataclasses.replace(item, mesh=pinched), *reconstruction.objects[1:])
    folder = save_reconstruction(dataclasses.replace(reconstruction, objects=objects), tmp_path / "result")
    entries = json.loads((folder / "scene.json").read_text())["objects"]
    assert [entry["watertight"] for entry in entries] == [False, True, True, True]


def test_vertices_keep_apart_from_nodes() -> None:
    from skimage.measure import marching_cubes

    rng = np.random.default_rng(0)
    values = rng.normal(size=(12, 12, 12)).astype(np.float32) * 10
    values[rng.random(values.shape) < 0.4] *= 1e-5  # many nodes next to the surface
    values = np.pad(off_the_surface(values), 1, constant_values=-20)
    vertices, faces, *_ = marching_cubes(values, 0.0, allow_degenerate=False)
    found = apart(vertices)
    assert np.abs(found - vertices).max() <= LEAST_GAP + 1e-5
    assert (np.abs(found - np.rint(found)).max(1) > 0.9 * LEAST_GAP).all()
    gaps = np.linalg.norm(found[faces] - np.roll(found[faces], 1, axis=1), axis=2)
    assert gaps.min() > LEAST_GAP


@pytest.mark.slow
def test_meshes_of_many_seeds_load_closed(tmp_path: Path) -> None:
    for seed in range(12):
        frame = make_tabletop(size=(240, 180), noise=0.002, seed=seed).frame
        folder = save_reconstruction(reconstruct(frame, seed=seed), tmp_path / str(seed))
        for path in folder.glob("objects/*/mesh.*"):
            assert trimesh.load(path).is_volume, path
