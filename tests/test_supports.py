"""Several supports, silhouettes without depth, and what carries no label: what perception makes of them."""

import dataclasses

import numpy as np
import pytest
from conftest import Shape, Tabletop, make_tabletop

from perception import Frame, Region, Space, observe
from perception.observation import NOTHING, OTHER, SUPPORT
from perception.quantiles import quantiles

TRAY = Shape("box", (0.30, 0.26, 0.06), (0.12, 0.20, 0.03))
ON_TRAY = (
    Shape("cylinder", (0.03, 0.10), (0.08, 0.15, 0.11)),
    Shape("box", (0.06, 0.08, 0.05), (0.14, 0.25, 0.085), 0.3),
)
ON_TABLE = (
    Shape("box", (0.07, 0.06, 0.12), (0.0, -0.15, 0.06)),
    Shape("sphere", (0.035,), (-0.05, -0.02, 0.035)),
)


@pytest.fixture(scope="module")
def steps() -> Tabletop:
    return make_tabletop((*ON_TABLE, *ON_TRAY), noise=0.001, background=(TRAY,))


def without_depth(frame: Frame, pixels: np.ndarray) -> Frame:
    depth = frame.depth.copy()
    depth.reshape(-1)[pixels] = np.nan
    return dataclasses.replace(frame, depth=depth)


def middle_of(frame: Frame, label: int, share: float = 0.3) -> np.ndarray:
    """Flat indices of the pixels of a label nearest to its centre, a share of them."""
    pixels = np.flatnonzero(frame.labels == label)
    places = np.stack(np.divmod(pixels, frame.depth.shape[1]), 1)
    order = np.argsort(np.linalg.norm(places - places.mean(0), axis=1))
    return pixels[order[: int(share * len(pixels))]]


def test_each_object_stands_on_the_support_under_it(steps: Tabletop) -> None:
    observation = observe(steps.frame)
    floors = {item.label: item.floor for item in observation.objects}
    assert all(item.rests for item in observation.objects)
    table = min(floors.values())
    np.testing.assert_allclose([floors[1], floors[2]], table, atol=0.002)
    np.testing.assert_allclose([floors[3] - table, floors[4] - table], 0.06, atol=0.003)
    for item in observation.objects:
        assert item.points[:, 2].min() > item.floor
        assert item.points[:, 2].min() < item.floor + 0.02
        assert len(item.points) > 0.85 * (steps.true_labels == item.label).sum()


def test_the_tray_is_a_support_on_top_and_an_obstacle_at_its_sides(steps: Tabletop) -> None:
    observation = observe(steps.frame)
    T = steps.frame.camera.T_world_camera
    world = steps.frame.camera.back_project(steps.true_depth) @ T[:3, :3].T + T[:3, 3]
    unlabelled = (steps.true_labels == 0) & np.isfinite(observation.depth)
    over = np.abs(world[..., :2] - TRAY.position[:2]) < np.array(TRAY.size[:2]) / 2 - 0.01
    top = unlabelled & over.all(-1) & (world[..., 2] > 0.058)
    assert (observation.seen[top] == SUPPORT).mean() > 0.95
    front = unlabelled & (world[..., 2] > 0.02) & (world[..., 2] < 0.04)
    assert front.sum() > 100
    assert (observation.seen[front] == OTHER).mean() > 0.95
    assert np.isin(np.flatnonzero(front), observation.other.pixels).mean() > 0.9


def test_one_support_is_the_rule(tabletop_frame: Frame) -> None:
    observation = observe(tabletop_frame)
    assert observation.levels == (0.0,)
    assert {item.floor for item in observation.objects} == {0.0}
    assert len(observation.other.pixels) < 20
    seen = observation.seen
    np.testing.assert_array_equal(seen == NOTHING, np.isnan(observation.depth))
    np.testing.assert_array_equal(np.where(seen > 0, seen, 0), observation.labels)


@pytest.mark.parametrize("label", [1, 2, 3])
def test_a_dropped_label_is_an_obstacle(tabletop_frame: Frame, label: int) -> None:
    labels = tabletop_frame.labels.copy()
    pixels = np.flatnonzero(labels == label)
    labels.reshape(-1)[pixels] = 0
    observation = observe(dataclasses.replace(tabletop_frame, labels=labels))
    measured = pixels[np.isfinite(observation.depth.reshape(-1)[pixels])]
    assert np.isin(measured, observation.other.pixels).mean() > 0.8
    seen = observation.seen.reshape(-1)[measured]
    assert np.isin(seen, (OTHER, SUPPORT)).all()  # its lowest centimetre passes for the table
    rays = observation.other.points - Space.of(observation).origin
    assert np.linalg.norm(rays, axis=1).max() < 2


@pytest.mark.parametrize("label", [1, 2, 3, 4])
def test_a_hole_in_a_mask_is_filled_from_around(tabletop: Tabletop, label: int) -> None:
    hole = middle_of(tabletop.frame, label)
    observation = observe(without_depth(tabletop.frame, hole))
    (item,) = [item for item in observation.objects if item.label == label]
    assert np.isin(hole, item.silhouette).all()
    assert np.isin(hole, item.guessed).mean() > 0.95
    guess, true = observation.guess.reshape(-1)[item.guessed], tabletop.true_depth.reshape(-1)[item.guessed]
    assert np.median(np.abs(guess - true)) < 0.004
    assert np.isnan(observation.depth.reshape(-1)[hole]).all()
    space = Space.of(observation)
    before = space.origin + 0.9 * (item.guessed_points - space.origin)
    behind = space.origin + 1.05 * (item.guessed_points - space.origin)
    assert not np.isin(space.classify(before.astype(np.float32)), (Region.FREE, Region.SURFACE)).any()
    assert np.isin(space.classify(behind.astype(np.float32)), (Region.OCCLUDED, Region.BELOW_SUPPORT)).all()


def test_what_is_seen_through_a_mask_is_not_its_object(tabletop: Tabletop) -> None:
    frame = tabletop.frame
    hole = middle_of(frame, 1, 0.5)
    # The depth of the table behind, along the same rays.
    camera = frame.camera
    rays = camera.rays.reshape(-1, 3)[hole] @ camera.T_world_camera[:3, :3].T
    depth = frame.depth.copy()
    depth.reshape(-1)[hole] = -camera.T_world_camera[2, 3] / rays[:, 2]
    observation = observe(dataclasses.replace(frame, depth=depth))
    (item,) = [item for item in observation.objects if item.label == 1]
    assert np.isin(hole, item.silhouette).mean() > 0.95
    assert np.isnan(observation.depth.reshape(-1)[hole]).mean() > 0.95
    assert any("only" in note and item.name in note for note in observation.notes)


def test_things_out_of_scale_are_skipped_with_the_reason(tabletop: Tabletop) -> None:
    wall = Shape("box", (0.1, 6.0, 6.0), (3.0, 0.0, 0.0))
    scene = make_tabletop((*tabletop.shapes, wall), noise=0.001)
    observation = observe(scene.frame)
    assert [item.label for item in observation.objects] != []
    (skipped,) = observation.skipped
    assert skipped.label == 5
    assert "m in size" in skipped.reason or "too large" in skipped.reason
    assert (observation.seen[scene.true_labels == 5] == OTHER).mean() > 0.9
    assert max(item.bounds[1].max() for item in observation.objects) < 0.5


def test_quantiles_are_numpys() -> None:
    values = np.random.default_rng(0).normal(size=101).astype(np.float32)
    shares = (0.0, 0.03, 0.5, 0.999, 1.0)
    np.testing.assert_allclose(quantiles(values, *shares), np.quantile(values, shares), atol=1e-6)


def test_seen_from_straight_above_nothing_hovers() -> None:
    from reconstruction import reconstruct

    shapes = (
        Shape("box", (0.06, 0.09, 0.16), (0.02, 0.08, 0.08), 0.4),
        Shape("cylinder", (0.035, 0.10), (-0.06, -0.08, 0.05)),
    )
    scene = make_tabletop(shapes, eye=(0.0, 0.0, 0.8), target=(0.0, 0.0, 0.0), noise=0.001)
    result = reconstruct(scene.frame)
    assert len(result.objects) == 2
    for item, shape in zip(sorted(result.objects, key=lambda item: item.label), shapes):
        assert item.mesh.bounds[0][2] < 0.005
        assert abs(item.extents[2] - shape.size[-1]) < 0.012
        low = item.mesh.vertices[:, 2] < 0.5 * shape.size[-1]
        assert item.uncertainty[low].mean() > item.uncertainty[~low].mean()  # there, but unsure
