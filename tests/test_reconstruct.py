"""The pipeline's promises: determinism, invariances, closed meshes, honest uncertainty, skips."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from conftest import make_tabletop
from solids import reconstructed_tabletop, true_meshes

from mapping import ConfigError, FrameError
from mapping.settings import override
from perception.camera import Camera, transform
from perception.space import Space
from reconstruction import preset, reconstruct
from reconstruction.config import MeshConfig
from reconstruction.metrics import chamfer

SIZE = (240, 180)


@pytest.fixture(scope="module")
def frame():
    return make_tabletop(size=SIZE).frame


@pytest.fixture(scope="module")
def result():
    return reconstructed_tabletop()


def farthest(a: trimesh.Trimesh, b: trimesh.Trimesh) -> float:
    """Largest distance [m] of a vertex of one mesh from the other's vertices, both ways."""
    from scipy.spatial import cKDTree

    there = cKDTree(b.vertices).query(a.vertices)[0].max()
    return float(max(there, cKDTree(a.vertices).query(b.vertices)[0].max()))


@pytest.mark.parametrize("name", ["tabletop", "paper"])
def test_every_object_is_a_closed_mesh_near_the_truth(frame, name):
    result = reconstruct(frame, preset(name))
    truth = true_meshes()
    assert sorted(item.label for item in result.objects) == sorted(truth)
    for item in result.objects:
        assert item.watertight
        assert item.mesh.volume > 0
        assert item.uncertainty.shape == (len(item.mesh.vertices),)
        assert 0 <= item.uncertainty.min() <= item.uncertainty.max() <= 1
        assert chamfer(item.mesh, truth[item.label], rng=np.random.default_rng(0)) < 0.035


def test_same_seed_same_bytes(frame, result):
    again = reconstruct(frame)
    for a, b in zip(result.objects, again.objects, strict=True):
        assert a.mesh.vertices.tobytes() == b.mesh.vertices.tobytes()
        assert a.mesh.faces.tobytes() == b.mesh.faces.tobytes()
        assert a.uncertainty.tobytes() == b.uncertainty.tobytes()


def test_renumbered_labels_give_the_same_meshes(frame, result):
    table = np.arange(65536).astype(np.uint16)
    table[1:5] = [900, 7, 31, 2]
    renumbered = reconstruct(replace(frame, labels=table[frame.labels], names={}))
    found = {item.label: item for item in renumbered.objects}
    for item in result.objects:
        assert farthest(item.mesh, found[int(table[item.label])].mesh) < 5e-4


def test_another_world_frame_moves_the_meshes_with_it(frame, result):
    T = trimesh.transformations.rotation_matrix(1.1, [0.3, -0.5, 0.8])
    T[:3, 3] = [3.0, -2.0, 0.7]
    camera = frame.camera
    moved_camera = Camera(camera.K, camera.width, camera.height, T @ camera.T_world_camera)
    moved = reconstruct(replace(frame, camera=moved_camera))
    for a, b in zip(result.objects, moved.objects, strict=True):
        np.testing.assert_allclose(transform(T, np.asarray(a.mesh.vertices)), b.mesh.vertices, atol=2e-3)
        np.testing.assert_allclose(T @ a.T_world_object, b.T_world_object, atol=2e-3)


def test_objects_end_at_the_support_plane(result):
    bottoms = [
        transform(np.linalg.inv(result.T_world_table), np.asarray(item.mesh.vertices))[:, 2].min()
        for item in result.objects
    ]
    assert min(bottoms) >= MeshConfig().floor - 1e-4
    assert np.median(np.abs(bottoms)) < 0.003


def test_an_object_does_not_grow_into_a_hole_of_the_depth_image(frame, result):
    # As beside depth edges of a stereo camera: 40 pixels on both sides of the tall box are lost.
    labels = frame.labels == 1
    columns, width = np.arange(frame.depth.shape[1]), frame.depth.shape[1]
    first = np.where(labels.any(1), labels.argmax(1), -width)[:, None]
    last = np.where(labels.any(1), width - 1 - labels[:, ::-1].argmax(1), 2 * width)[:, None]
    left, right = (columns > first - 40) & (columns < first), (columns > last) & (columns < last + 40)
    hole = (left | right) & (frame.labels == 0)
    depth = np.where(hole, np.nan, frame.depth).astype(np.float32)
    holed = reconstruct(replace(frame, depth=depth))
    whole, found = (next(o for o in r.objects if o.label == 1).mesh for r in (result, holed))
    assert hole.sum() > 1000
    assert found.bounds == pytest.approx(whole.bounds, abs=0.012)


def test_query_answers_in_the_world_frame(result):
    for item in result.objects:
        # A seen surface point, a little inside along its ray.
        observed = next(o for o in result.observation.objects if o.label == item.label)
        origin = Space.of(result.observation).origin
        point = observed.points[len(observed.points) // 2].astype(float)
        behind = point + 0.006 * (point - origin) / np.linalg.norm(point - origin)
        before = point - 0.02 * (point - origin) / np.linalg.norm(point - origin)
        query = result.query(transform(result.T_world_table, np.stack([behind, before])))
        assert query.label.tolist() == [item.label, 0]
        assert query.occupancy[0] > 0.5 > query.occupancy[1]
        assert query.gradient.shape == (2, 3)


def test_query_keeps_labels_apart_when_an_object_got_no_mesh(result):
    item = result.objects[-1]
    inner = np.asarray(item.mesh.vertices).mean(0, keepdims=True)
    fewer = replace(result, objects=result.objects[1:])
    assert fewer.query(inner).label.tolist() == result.query(inner).label.tolist() == [item.label]


def test_query_finds_nothing_inside_the_table(result):
    under = np.concatenate([o.points[::20] for o in result.observation.objects]) * [1, 1, 0] + [0, 0, -0.004]
    query = result.query(transform(result.T_world_table, under))
    assert (query.occupancy == 0).all()
    assert not np.isin(query.label, [item.label for item in result.objects]).any()
    assert (query.gradient == 0).all()


def test_vertices_lie_where_the_map_is_undecided(frame):
    result = reconstruct(frame, preset("tabletop", mesh={"fusion": {"enabled": False}}))
    item = result.objects[0]
    local = transform(np.linalg.inv(result.T_world_table), np.asarray(item.mesh.vertices)[::50])
    p = result.map.predict_proba(local)[:, :-1]
    share = p[:, item.class_index] / p.sum(1)
    assert np.median(np.abs(share - 0.5)) < 0.05


def test_a_tiny_object_is_skipped_and_the_others_are_delivered(frame):
    labels = frame.labels.copy()
    rows, columns = np.nonzero(labels == 2)
    labels[rows[5:], columns[5:]] = 0
    result = reconstruct(replace(frame, labels=labels))
    assert [s.label for s in result.skipped] == [2]
    assert "pixels" in result.skipped[0].reason
    assert sorted(item.label for item in result.objects) == [1, 3, 4]


def test_a_frame_of_tiny_objects_is_refused(frame):
    labels = np.zeros_like(frame.labels)
    labels[:2, :3] = 1
    with pytest.raises(FrameError):
        reconstruct(replace(frame, labels=labels))


def test_unknown_settings_name_the_valid_ones():
    with pytest.raises(ConfigError, match=r"mesh\.spacin.*spacing"):
        override(preset("tabletop"), {"mesh": {"spacin": 0.1}})
    with pytest.raises(ConfigError, match="paper, tabletop"):
        preset("nonsense")


def test_diagnostics_are_complete(result):
    assert {"observe", "space", "samples", "fit", "field", "mesh", "total"} <= set(result.timings_ms)
    assert result.map.report.converged
    assert result.map.report.losses[-1] < result.map.report.losses[0]
    assert len(result.samples) == len(result.sample_classes)
    assert result.config["preset"] == "tabletop"
