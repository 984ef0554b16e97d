"""Uncertainty of a reconstruction: seen is sure, hidden and far is not, and it ranks errors."""

import numpy as np
import pytest
from conftest import make_tabletop
from solids import reconstructed_tabletop, true_meshes

from mapping.settings import override
from perception.camera import transform
from perception.observing import observe
from perception.space import Region, Space
from reconstruction import preset, reconstruct
from reconstruction.config import TabletopLabels
from reconstruction.metrics import inside
from reconstruction.samples import labels as label_rules
from reconstruction.surface.measured_vertices import LEAST, share_left
from reconstruction.surface.seen_surface import SeenSurface
from tools.evaluation.statistics import auroc

SIZE = (240, 180)


@pytest.fixture(scope="module")
def frame():
    return make_tabletop(size=SIZE).frame


@pytest.fixture(scope="module")
def result():
    return reconstructed_tabletop()


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
    for filled in (np.ones(3, bool), np.zeros(3, bool)):
        labels = label_rules.wall(TabletopLabels(), np.array([1, 2, 1]), np.array([0.0, 0.8, 1.0]), 3, filled)
        np.testing.assert_allclose(labels.sum(1), 1, atol=1e-6)
        assert ((labels[:, :3] > 0) == np.eye(3, dtype=bool)[[1, 2, 1]]).all()
        assert (np.diff(labels[:, -1]) > 0).all()


def test_what_may_be_hollow_is_less_sure_but_the_same_thing():
    rules = TabletopLabels()
    structure = np.array([[0.1, 0.9, 0.0], [0.1, 0.9, 0.0], [0.9, 0.1, 0.0]])
    labels = label_rules.hidden(rules, structure, filled=np.array([True, False, False]))
    plain = label_rules.hidden(rules, structure)
    np.testing.assert_allclose(labels[[0, 2]], plain[[0, 2]])  # full, or empty anyway
    assert plain[1, -1] + 0.1 < labels[1, -1] < 1
    np.testing.assert_allclose(labels[:, :-1] / labels[:, :-1].sum(1, keepdims=True), structure, atol=1e-6)
    full, hollow = (
        label_rules.wall(rules, np.array([1]), np.array([0.3]), 3, np.array([filled]))
        for filled in (True, False)
    )
    assert full[0, -1] + 0.1 < hollow[0, -1]


def test_under_a_hidden_foot_nothing_is_but_how_sure_follows_what_stands_there():
    labels = label_rules.foot(TabletopLabels(), np.array([[1.0, 0.0, 0.0], [0.5, 0.5, 0.0]]))
    np.testing.assert_allclose(labels.sum(1), 1, atol=1e-6)
    assert (labels[:, 1:-1] == 0).all()
    assert labels[1, -1] > labels[0, -1]


def test_far_from_everything_is_uncertain(result):
    assert result.map.predict_proba(np.array([[9.0, 9.0, 9.0]]))[0, -1] > 0.9
    query = result.query(np.array([[9.0, 9.0, 9.0]]))
    assert query.label.tolist() == [-1]


def test_keeping_only_what_is_sure_leaves_a_smaller_closed_mesh(frame, result):
    sure = reconstruct(frame, override(preset("tabletop"), {"mesh": {"max_uncertainty": 0.3}}))
    volume = {item.label: item.mesh.volume for item in result.objects}
    for item in sure.objects:
        assert item.watertight
        assert item.mesh.volume < volume[item.label]
        assert np.quantile(item.uncertainty, 0.9) < 0.45


def test_measured_vertices_are_surer_than_hidden_ones(result):
    from scipy.spatial import cKDTree

    for item, seen in zip(result.objects, result.observation.objects):
        vertices = transform(np.linalg.inv(result.T_world_table), np.asarray(item.mesh.vertices))
        off = cKDTree(seen.points).query(vertices)[0]
        on, hidden = item.uncertainty[off < 0.0015], item.uncertainty[off > 0.015]
        assert np.median(on) < 0.02
        assert np.median(on) < 0.1 * np.median(hidden)


def test_the_far_side_of_a_thin_wall_is_not_measured():
    edges = SeenSurface.of(observe(make_tabletop(size=SIZE).frame)).edges(0)
    points = observe(make_tabletop(size=SIZE).frame).objects[0].points.astype(np.float32)
    shown = edges.facing(points)[0].any(1)
    on, behind = points[shown], edges.behind(points[shown], 0.006)
    assert np.median(share_left(edges, on)) == LEAST
    assert np.median(share_left(edges, behind)) == 1
