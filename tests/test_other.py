"""Everything measured is somewhere: what carries no label is an obstacle of the map, and never free."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from conftest import Tabletop, shape_mesh

from perception.camera import transform
from perception.observation import NOTHING, OTHER, SUPPORT
from reconstruction import reconstruct
from reconstruction.files.result_folder import load_result, save_reconstruction
from reconstruction.result import Reconstruction

DROPPED = 1
"""The box; its label is removed."""


@pytest.fixture(scope="module")
def result(tabletop: Tabletop) -> Reconstruction:
    labels = np.where(tabletop.frame.labels == DROPPED, 0, tabletop.frame.labels).astype(np.uint16)
    return reconstruct(dataclasses.replace(tabletop.frame, labels=labels))


def inside_of_dropped(tabletop: Tabletop, count: int = 4000) -> np.ndarray:
    import open3d as o3d

    legacy = shape_mesh(tabletop.shapes[DROPPED - 1])
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(legacy))
    low, high = legacy.get_min_bound(), legacy.get_max_bound()
    points = np.random.default_rng(0).uniform(low, high, (count, 3)).astype(np.float32)
    return points[scene.compute_occupancy(o3d.core.Tensor(points)).numpy() > 0]


def test_the_inside_of_a_dropped_object_is_not_free(tabletop: Tabletop, result: Reconstruction) -> None:
    answer = result.query(inside_of_dropped(tabletop))
    assert len(answer.label) > 500
    assert ((answer.label == 0) & (answer.uncertainty < 0.3)).mean() <= 0.01
    assert (answer.label == OTHER).mean() > 0.1


def test_nothing_measured_is_free(tabletop: Tabletop, result: Reconstruction) -> None:
    frame = tabletop.frame
    points = frame.camera.back_project(frame.depth)[np.isfinite(result.observation.depth)]
    answer = result.query(transform(frame.camera.T_world_camera, points))
    assert (answer.label == 0).mean() <= 0.001
    assert {OTHER, SUPPORT} <= set(np.unique(answer.label).tolist())


def test_query_tells_kinds_apart(tabletop: Tabletop, result: Reconstruction) -> None:
    eye = tabletop.frame.camera.T_world_camera[:3, 3]
    top = np.array([0.10, 0.12, 0.20])  # of the box without a label
    places = {
        0: top + 0.3 * (eye - top) / np.linalg.norm(eye - top) * 0.3,
        OTHER: top - [0, 0, 0.004],
        SUPPORT: np.array([-0.1, 0.0, -0.01]),
        NOTHING: np.array([3.0, 3.0, 1.0]),
    }
    assert result.query(np.array(list(places.values()))).label.tolist() == list(places)
    # Inside the table, wherever the camera saw its top.
    under = np.random.default_rng(0).uniform([-0.2, -0.25, -0.03], [0.2, 0.25, -0.005], (500, 3))
    answer = result.query(under)
    assert (answer.label == SUPPORT).mean() > 0.95
    assert not (answer.label == 0).any()


def test_the_columns_keep_their_order(result: Reconstruction) -> None:
    kept = result.observation.objects
    assert result.map.class_count == len(kept) + 3
    assert result.other is not None
    assert result.other.class_index == len(kept) + 1
    assert [item.class_index for item in result.objects] == list(range(1, len(kept) + 1))


def test_the_obstacle_has_a_closed_mesh_where_it_was_seen(tabletop: Tabletop, result: Reconstruction) -> None:
    from reconstruction.solid import Solid

    assert result.other is not None
    mesh = result.other.mesh
    assert mesh.is_watertight
    world = transform(result.T_world_table, result.observation.other.points)
    assert np.quantile(Solid(mesh).distance(world), 0.9) < 0.01
    low, high = shape_mesh(tabletop.shapes[0]).get_min_bound(), shape_mesh(tabletop.shapes[0]).get_max_bound()
    assert np.abs(mesh.bounds[0][2]) < 0.02
    assert (np.abs(mesh.bounds[1] - high) < 0.06).all()
    assert (mesh.bounds[0] > low - 0.06).all()


def test_the_result_folder_delivers_it(result: Reconstruction, tmp_path: Path) -> None:
    folder = save_reconstruction(result, tmp_path / "out")
    scene = json.loads((folder / "scene.json").read_text())
    assert scene["other"]["class_index"] == len(result.objects) + 1
    assert (folder / scene["other"]["mesh"]).is_file()
    assert (folder / scene["other"]["mesh_obj"]).is_file()
    assert scene["supports"] == [{"height": 0.0, "carries": [item.label for item in result.objects]}]
    for entry in scene["objects"]:
        assert entry["measured_pixels"] <= entry["labelled_pixels"]
        assert entry["support_height"] == 0
        assert not any("support" in note for note in entry["notes"])
    assert len(load_result(folder).objects) == len(result.objects)


def test_without_obstacles_there_is_no_such_class(tabletop: Tabletop) -> None:
    result = reconstruct(tabletop.frame)
    assert result.other is None
    assert result.map.class_count == len(result.observation.objects) + 2
