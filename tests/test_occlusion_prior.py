"""The occlusion prior: properties every set of weights must have, and what the shipped ones know."""

from __future__ import annotations

import json

import numpy as np
import pytest
from conftest import OBJECTS, Shape, make_tabletop

from mapping.errors import DataError
from perception.camera import invert_rigid, transform
from perception.observing import observe
from perception.space import Space
from reconstruction.prior.evidence import (
    BORDER_REACH_PX,
    Border,
    RayLookup,
    border_distance,
    hidden_labels,
)
from reconstruction.prior.features import UNKNOWN, ObjectBox, RayEvidence
from reconstruction.prior.footprint import CELLS, Footprint
from reconstruction.prior.network import WIDTHS, PriorNetwork
from reconstruction.prior.occlusion_prior import WEIGHTS_FILE, OcclusionPrior, save_weights


@pytest.fixture(scope="module")
def scene():
    """Observation, space, visible points of each object, and hidden points near the objects."""
    observation = observe(make_tabletop(noise=0.001).frame)
    space = Space.of(observation)
    rng = np.random.default_rng(0)
    points = rng.uniform([-0.25, -0.25, 0.001], [0.25, 0.25, 0.22], (6000, 3)).astype(np.float32)
    points = points[space.depth_behind(points) > 0.001]
    return observation, space, [item.points for item in observation.objects], points


def test_rows_are_distributions(scene):
    observation, space, _, points = scene
    rows = hidden_labels(observation, space, points)
    assert rows.shape == (len(points), len(OBJECTS) + 1)
    assert rows.dtype == np.float32
    assert rows.min() >= 0
    np.testing.assert_allclose(rows.sum(axis=1), 1, atol=1e-5)
    assert rows[:, 1:].max() > 0.9, "some hidden points must surely belong to an object"
    np.testing.assert_allclose(rows, hidden_labels(observation, space, points), atol=1e-6)
    observation.memo.clear()
    np.testing.assert_array_equal(rows, hidden_labels(observation, space, points))


@pytest.mark.parametrize("only", [None, (1,), (0, 2)])
def test_few_points_asked_later_have_the_same_answers(scene, only):
    """They are answered for all objects at once, however many points were asked about before."""
    observation, space, visible, points = scene
    memo = {}
    lookup = RayLookup(observation, space)
    floors = [item.floor for item in observation.objects]
    asked = (visible, space.origin, lookup)
    prior = OcclusionPrior.load()
    alone = prior.log_odds(*asked, points, floors, None, only)
    calls = []
    decode_rows = prior.network.decode_rows
    prior.network.decode_rows = lambda *given: calls.append(1) or decode_rows(*given)
    try:
        prior.log_odds(*asked, points, floors, memo, only)
        assert not calls
        for few in (points[5:300], points[:1], points[:0]):
            again = prior.log_odds(*asked, few, floors, memo, only)
            np.testing.assert_allclose(again, alone[np.isin(points, few).all(1)], atol=2e-4)
    finally:
        del prior.network.decode_rows
    assert calls


def test_turning_the_table_changes_nothing(scene):
    observation, space, visible, points = scene
    prior, lookup = OcclusionPrior.load(), RayLookup(observation, space)
    c, s = np.cos(1.1), np.sin(1.1)
    T = np.array([[c, -s, 0, 0.3], [s, c, 0, -0.2], [0, 0, 1, 0], [0, 0, 0, 1]])
    back = invert_rigid(T)
    turned = prior.distribution(
        [transform(T, item) for item in visible],
        transform(T, space.origin),
        lambda moved, index: lookup(transform(back, moved), index),
        transform(T, points),
    )
    change = np.abs(turned - prior.distribution(visible, space.origin, lookup, points)).max(axis=1)
    # Rounding moves a few points and cells over the border between two pixels.
    assert np.median(change) < 1e-3
    assert np.quantile(change, 0.95) < 0.1


def test_order_of_objects_permutes_columns(scene):
    observation, space, visible, points = scene
    prior, lookup = OcclusionPrior.load(), RayLookup(observation, space)
    order = np.array([2, 0, 3, 1])
    rows = prior.distribution(visible, space.origin, lookup, points)
    shuffled = prior.distribution(
        [visible[index] for index in order],
        space.origin,
        lambda where, index: lookup(where, order[index]),
        points,
    )
    np.testing.assert_allclose(shuffled[:, 0], rows[:, 0], atol=1e-4)
    np.testing.assert_allclose(shuffled[:, 1:], rows[:, 1 + order], atol=1e-4)


@pytest.mark.parametrize("size", [(0.08, 0.10, 0.12), (0.16, 0.06, 0.20)])
def test_hidden_half_of_a_box(size):
    box = Shape("box", size, (0.0, 0.0, size[2] / 2), 0.3)
    tabletop = make_tabletop(shapes=(box,))
    observation = observe(tabletop.frame)
    space = Space.of(observation)
    rng = np.random.default_rng(1)
    T_table_world = observation.T_table_camera @ invert_rigid(tabletop.frame.camera.T_world_camera)
    turn = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    inner = rng.uniform(-0.45, 0.45, (3000, 3)) * size
    inner[:, :2] = inner[:, :2] @ turn.T
    inner[:, 2] += size[2] / 2
    inner = transform(T_table_world, inner.astype(np.float32))
    inner = inner[space.depth_behind(inner) > 0.03]
    assert len(inner) > 100
    assert np.mean(hidden_labels(observation, space, inner)[:, 1] > 0.5) > 0.9

    around = rng.uniform([-0.1, -0.15, 0.002], [0.4, 0.15, 0.1], (8000, 3)).astype(np.float32)
    world = transform(invert_rigid(T_table_world), around)
    far = (space.depth_behind(around) > 0.02) & (world[:, 0] > 0.6 * np.hypot(*size[:2]) + 0.02)
    assert far.sum() > 50
    assert hidden_labels(observation, space, around[far])[:, 1].mean() < 0.2


def test_below_the_table_and_out_of_reach_is_empty(scene):
    observation, space, *_ = scene
    points = np.array([[0, 0, -0.01], [3, 0, 0.1], [0, 0, 2.0]], np.float32)
    np.testing.assert_allclose(hidden_labels(observation, space, points)[:, 0], 1, atol=1e-3)


def test_no_points_and_no_support(scene):
    observation, space, visible, _ = scene
    assert hidden_labels(observation, space, np.empty((0, 3), np.float32)).shape == (0, len(visible) + 1)
    from dataclasses import replace

    rows = hidden_labels(replace(observation, support=None), space, np.zeros((2, 3), np.float32))
    np.testing.assert_allclose(rows, 1 / (len(visible) + 1))


def test_unknown_rays_are_finite(scene):
    _, space, visible, points = scene

    def nothing(where: np.ndarray, index: int) -> RayEvidence:
        blank = np.full(len(where), np.nan, np.float32)
        return RayEvidence(blank, np.full(len(where), UNKNOWN, np.int8), np.zeros(len(where), np.float32))

    assert np.isfinite(OcclusionPrior.load().distribution(visible, space.origin, nothing, points)).all()


def test_box_holds_what_is_seen(scene):
    _, space, visible, _ = scene
    for item in visible:
        box = ObjectBox.around(item, space.origin)
        assert np.abs(box.local(item)).max() < 1
        np.testing.assert_allclose(np.abs(box.local(box.lattice())).max(0), 1, atol=0.1)
        assert 0 < box.surface_cells(item).sum() <= len(item)


def test_border_is_measured_near_the_object_and_constant_far_from_it():
    height, width = 120, 160
    rows, columns = np.meshgrid(np.arange(10, 30), np.arange(5, 25), indexing="ij")
    border = Border.of((rows * width + columns).reshape(-1), height, width)
    image = np.array([border_distance(*border, place) for place in range(height * width)]).reshape(
        height, width
    )
    assert image[19, 14] == pytest.approx(10, rel=0.06)
    assert image[19, 0] == pytest.approx(-5, rel=0.06)
    assert image[60, 14] == pytest.approx(-31, rel=0.06)
    assert (image[90:] == -BORDER_REACH_PX).all()
    assert (image[:, 80:] == -BORDER_REACH_PX).all()


def test_weights_are_small_and_described():
    assert WEIGHTS_FILE.stat().st_size < 2_000_000
    record = json.loads(WEIGHTS_FILE.with_suffix(".json").read_text())
    assert record["command"].startswith("python -m tools.train_prior")
    assert not set(record["training_families"]) & set(record["held_out_families"])
    assert record["scores"]["held_out_families"]["iou"] > 0.5
    assert record["scores"]["held_out_meshes"]["iou"] > 0.6
    assert "CC BY 4.0" in record["household"]["attribution"]
    assert not any("mixed" in licence for licence in record["household"]["objects_by_source_and_licence"])


def test_weights_survive_the_file_and_wrong_ones_are_named(tmp_path):
    network = PriorNetwork()
    save_weights(network, tmp_path / "weights.npz")
    loaded = OcclusionPrior.load(tmp_path / "weights.npz").network
    for name, value in network.state_dict().items():
        np.testing.assert_allclose(loaded.state_dict()[name], value, atol=1e-3)
    with pytest.raises(DataError, match=r"train_prior"):
        OcclusionPrior.load(tmp_path / "missing.npz")
    np.savez(tmp_path / "other.npz", something=np.zeros(3))
    with pytest.raises(DataError, match="another network"):
        OcclusionPrior.load(tmp_path / "other.npz")
    with np.load(tmp_path / "weights.npz") as stored:
        state = dict(stored)
    made_for = json.loads(str(state["architecture"]))
    made_for["point_channels"] = [*made_for["point_channels"][:-1], "smell"]
    np.savez(tmp_path / "other.npz", **{**state, "architecture": np.array(json.dumps(made_for))})
    with pytest.raises(DataError, match=r"other point_channels"):  # the same shapes, another meaning
        OcclusionPrior.load(tmp_path / "other.npz")


def test_another_prior_can_take_its_place(scene):
    observation, space, _, points = scene

    class Shell:
        """Everything up to a centimetre behind a seen surface belongs to the first object."""

        channels = ("behind",)

        def distribution(self, visible, origin, evidence, points, floors=None):
            filled = evidence(points, 0).behind < 0.01
            rows = np.zeros((len(points), len(visible) + 1), np.float32)
            rows[np.arange(len(points)), filled.astype(int)] = 1
            return rows

    rows = hidden_labels(observation, space, points, Shell())
    np.testing.assert_array_equal(rows[:, 1] > 0.5, space.depth_behind(points) < 0.01)
    prior = OcclusionPrior.load()
    assert len(prior.channels) == len(set(prior.channels)) == prior.network.decoder[0].in_features - WIDTHS[0]


def test_plan_view_ends_where_the_seen_top_ends():
    """A box of 16 x 10 x 20 cm: its front and top are seen, its plan view is known."""
    rng = np.random.default_rng(0)
    front = rng.uniform([0, -0.05, 0], [0.001, 0.05, 0.2], (20000, 3))
    top = rng.uniform([0, -0.05, 0.199], [0.16, 0.05, 0.2], (20000, 3))
    visible = np.concatenate([front, top]).astype(np.float32)
    box = ObjectBox.around(visible, np.array([-0.6, 0.0, 0.5]))
    plan = Footprint.of(box, visible)
    cell = box.size[0] / CELLS
    depth = np.linspace(-0.02, 0.2, 45)
    points = np.stack([depth, 0 * depth, 0 * depth + 0.1], axis=1).astype(np.float32)
    distance, above = plan.at(box, box.local(points))
    true = np.minimum(np.minimum(depth, 0.16 - depth), 0.05)
    np.testing.assert_allclose(distance, true, atol=1.5 * cell)
    under = (depth > cell) & (depth < 0.16 - cell)
    np.testing.assert_allclose(above[under], 0.1, atol=0.002)
    assert np.isnan(above[depth > 0.16 + cell]).all()
