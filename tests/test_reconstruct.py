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
from perception.space import Region, Space
from reconstruction import preset, reconstruct
from reconstruction.config import MeshConfig, TabletopLabels
from reconstruction.metrics import chamfer, inside
from reconstruction.samples import labels as label_rules
from tools.evaluation.statistics import auroc

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


def test_seen_surface_is_certain_and_hidden_space_is_not(result):
    space = Space.of(result.observation)
    seen = np.concatenate([item.points for item in result.observation.objects])
    u = result.map.predict_proba(seen)[:, -1]
    assert np.median(u) < 0.1
    low, high = seen.min(0), seen.max(0)
    points = np.random.default_rng(0).uniform(low, high, (4000, 3)).astype(np.float32)
    region = space.classify(points)
    judged = (region == Region.OCCLUDED) | (region == Region.FREE)
    u = result.map.predict_proba(points[judged])[:, -1]
    # Not a difference of levels: what the prior is sure of is rightly not very uncertain.
    assert auroc(u, region[judged] == Region.OCCLUDED) > 0.93


def test_uncertainty_ranks_errors_in_hidden_space(result):
    """Among occluded points p(uncertain) tells wrong answers from right ones."""
    seen = np.concatenate([item.points for item in result.observation.objects])
    low, high = seen.min(0) - 0.05, seen.max(0) + 0.05
    points = np.random.default_rng(0).uniform([*low[:2], 0.0], high, (40_000, 3)).astype(np.float32)
    points = points[Space.of(result.observation).classify(points) == Region.OCCLUDED]
    world = transform(result.T_world_table, points)
    truth = np.zeros(len(points), int)
    for item in result.objects:
        truth[inside(true_meshes()[item.label], world)] = item.class_index
    p = result.map.predict_proba(points)
    wrong = p[:, :-1].argmax(1) != truth
    assert auroc(p[:, -1], wrong) > 0.83


def test_labels_of_hidden_samples_are_as_uncertain_as_their_guess_is_likely_wrong():
    rules = TabletopLabels()
    chance = np.linspace(1, 1 / 3, 20)  # of the likeliest of three classes
    structure = np.column_stack([chance, (1 - chance) / 2, (1 - chance) / 2])
    labels = label_rules.hidden(rules, structure)
    np.testing.assert_allclose(labels.sum(1), 1, atol=1e-6)
    np.testing.assert_allclose(labels[:, :-1] / labels[:, :-1].sum(1, keepdims=True), structure, atol=1e-6)
    assert (np.diff(labels[chance > 0.5, -1]) > 0).all()
    assert labels[[0, -1], -1] == pytest.approx([rules.least_uncertain, rules.most_uncertain])


def test_doubt_behind_a_surface_goes_to_uncertain_and_to_no_other_class():
    rules = TabletopLabels()
    labels = label_rules.pair(rules, np.array([2, 2, 1]), np.array([0.0, 0.6, 1.0]), 3)
    np.testing.assert_allclose(labels.sum(1), 1, atol=1e-6)
    assert ((labels[:, :3] > 0) == np.eye(3, dtype=bool)[[2, 2, 1]]).all()
    assert labels[0, -1] == pytest.approx(rules.pair_uncertain)
    assert (np.diff(labels[:, -1]) > 0).all()


def test_a_wall_keeps_its_thickness_however_much_it_is_doubted():
    labels = label_rules.wall(TabletopLabels(), np.array([1, 2, 1]), np.array([0.0, 0.8, 1.0]), 3)
    np.testing.assert_allclose(labels.sum(1), 1, atol=1e-6)
    assert ((labels[:, :3] > 0) == np.eye(3, dtype=bool)[[1, 2, 1]]).all()
    assert (np.diff(labels[:, -1]) > 0).all()


def test_under_a_hidden_foot_nothing_is_but_how_sure_follows_what_stands_there():
    labels = label_rules.foot(TabletopLabels(), np.array([[1.0, 0.0, 0.0], [0.5, 0.5, 0.0]]))
    np.testing.assert_allclose(labels.sum(1), 1, atol=1e-6)
    assert (labels[:, 1:-1] == 0).all()
    assert labels[1, -1] > labels[0, -1]


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


def test_far_from_everything_is_uncertain(result):
    assert result.map.predict_proba(np.array([[9.0, 9.0, 9.0]]))[0, -1] > 0.9
    query = result.query(np.array([[9.0, 9.0, 9.0]]))
    assert query.label.tolist() == [-1]


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


def test_vertices_lie_where_the_map_is_undecided(result):
    item = result.objects[0]
    local = transform(np.linalg.inv(result.T_world_table), np.asarray(item.mesh.vertices)[::50])
    p = result.map.predict_proba(local)[:, :-1]
    share = p[:, item.class_index] / p.sum(1)
    assert np.median(np.abs(share - 0.5)) < 0.05


def test_keeping_only_what_is_sure_leaves_a_smaller_closed_mesh(frame, result):
    sure = reconstruct(frame, override(preset("tabletop"), {"mesh": {"max_uncertainty": 0.3}}))
    volume = {item.label: item.mesh.volume for item in result.objects}
    for item in sure.objects:
        assert item.watertight
        assert item.mesh.volume < volume[item.label]
        assert np.quantile(item.uncertainty, 0.9) < 0.45


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
    from reconstruction.surface.field import evaluate_field

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
        np.testing.assert_allclose(field.uncertainty[window], probability[(*window, -1)], atol=0.02)
