"""The whole perception stage: table frame, invariances, skipped objects."""

import dataclasses

import numpy as np
import pytest
from conftest import Tabletop, make_tabletop
from test_camera import random_pose

from mapping import ConfigError, FrameError
from perception import Camera, Frame, Observation, PerceptionConfig, observe
from perception.camera import invert_rigid, transform


@pytest.fixture(scope="module")
def observation(tabletop_frame: Frame) -> Observation:
    return observe(tabletop_frame)


def test_points_lie_on_the_true_shapes(tabletop: Tabletop, observation: Observation) -> None:
    import open3d as o3d

    T_world_table = tabletop.frame.camera.T_world_camera @ invert_rigid(observation.T_table_camera)
    assert [item.name for item in observation.objects] != []
    for item in observation.objects:
        world = transform(T_world_table, item.points)
        distance = tabletop.scene.compute_distance(o3d.core.Tensor(world)).numpy()
        assert np.quantile(distance, 0.95) < 0.004
        assert (tabletop.true_labels.reshape(-1)[item.pixels] == item.label).all()
        true = (tabletop.true_labels == item.label).sum()
        assert len(item.points) > 0.85 * true
        assert item.dropped == item.labelled - len(item.points)


def test_table_frame(tabletop: Tabletop, observation: Observation) -> None:
    T = observation.T_table_camera
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)
    assert np.linalg.det(T[:3, :3]) > 0
    # The camera looks along the world's x, so the axes agree; z is up and 0 on the table.
    T_world_table = tabletop.frame.camera.T_world_camera @ invert_rigid(T)
    np.testing.assert_allclose(T_world_table[:3, :3], np.eye(3), atol=0.02)
    assert abs(T_world_table[2, 3]) < 0.002
    centroid = np.concatenate([item.points for item in observation.objects]).mean(0)
    np.testing.assert_allclose(centroid[:2], 0, atol=1e-4)


def test_cleaned_images_agree_with_the_objects(tabletop_frame: Frame, observation: Observation) -> None:
    points = transform(observation.T_table_camera, observation.camera.back_project(observation.depth))
    for item in observation.objects:
        np.testing.assert_array_equal(np.flatnonzero(observation.labels == item.label), item.pixels)
        np.testing.assert_allclose(points.reshape(-1, 3)[item.pixels], item.points, atol=1e-6)
    kept = ~np.isnan(observation.depth)
    np.testing.assert_array_equal(observation.depth[kept], tabletop_frame.depth[kept])


@pytest.mark.parametrize("seed", range(3))
def test_the_world_frame_has_no_influence(tabletop_frame: Frame, observation: Observation, seed: int) -> None:
    camera = tabletop_frame.camera
    moved = Camera(camera.K, camera.width, camera.height, random_pose(seed))
    other = observe(dataclasses.replace(tabletop_frame, camera=moved))
    np.testing.assert_array_equal(other.T_table_camera, observation.T_table_camera)
    for item, same in zip(other.objects, observation.objects, strict=True):
        np.testing.assert_array_equal(item.points, same.points)


@pytest.mark.parametrize("new", [(4, 3, 2, 1), (7, 65535, 1, 300)])
def test_renumbering_labels_changes_nothing_else(
    tabletop_frame: Frame, observation: Observation, new: tuple[int, ...]
) -> None:
    table = np.array([0, *new], np.uint16)
    other = observe(dataclasses.replace(tabletop_frame, labels=table[tabletop_frame.labels], names={}))
    np.testing.assert_array_equal(other.T_table_camera, observation.T_table_camera)
    np.testing.assert_array_equal(other.labels, table[observation.labels])
    for item, same in zip(other.objects, observation.objects, strict=True):
        assert item.label == table[same.label]
        np.testing.assert_array_equal(item.points, same.points)


def test_the_same_seed_gives_the_same_result(tabletop_frame: Frame, observation: Observation) -> None:
    again = observe(tabletop_frame, seed=0)
    np.testing.assert_array_equal(again.T_table_camera, observation.T_table_camera)
    np.testing.assert_array_equal(again.labels, observation.labels)
    other = observe(tabletop_frame, seed=1)
    angle = np.arccos(np.clip(other.T_table_camera[2, :3] @ observation.T_table_camera[2, :3], -1, 1))
    assert np.degrees(angle) < 0.3


def test_small_objects_are_skipped_with_the_reason(tabletop_frame: Frame) -> None:
    labels = tabletop_frame.labels.copy()
    row, column = np.argwhere(labels == 2)[0]
    labels[labels == 2] = 0
    labels[row, column : column + 5] = 2
    result = observe(dataclasses.replace(tabletop_frame, labels=labels))
    assert {item.label for item in result.objects} == {1, 3, 4}
    assert [item.label for item in result.skipped] == [2]
    assert "at least 30" in result.skipped[0].reason
    assert not (result.labels == 2).any()


def test_an_object_without_depth_is_skipped(tabletop_frame: Frame) -> None:
    depth = np.where(tabletop_frame.labels == 3, np.nan, tabletop_frame.depth)
    result = observe(dataclasses.replace(tabletop_frame, depth=depth))
    assert [item.label for item in result.skipped] == [3]
    assert len(result.objects) == 3


def test_nothing_left_is_an_error(tabletop_frame: Frame) -> None:
    labels = np.zeros_like(tabletop_frame.labels)
    labels[100, 100:110] = 5
    with pytest.raises(FrameError, match="no object is left"):
        observe(dataclasses.replace(tabletop_frame, labels=labels))


def test_without_a_plane_the_camera_frame_is_used(tabletop_frame: Frame) -> None:
    result = observe(tabletop_frame, PerceptionConfig(use_plane=False))
    assert result.support is None
    np.testing.assert_array_equal(result.T_table_camera, np.eye(4))
    assert any("no support plane" in note for note in result.notes)
    assert len(result.objects) == 4


def test_without_labels_objects_are_segmented_and_a_note_says_so(tabletop: Tabletop) -> None:
    result = observe(dataclasses.replace(tabletop.frame, labels=None))
    assert any("segmentation" in note for note in result.notes)
    assert len(result.objects) == 4


def test_looking_straight_down_works() -> None:
    scene = make_tabletop(eye=(0.0, 0.0, 0.8), target=(0.0, 0.0, 0.0), noise=0.0015)
    result = observe(scene.frame)
    assert len(result.objects) == 4
    # The image's upward direction counts as "away".
    up = invert_rigid(result.T_table_camera)[:3, 0]
    assert up @ [0.0, -1.0, 0.0] > 0.99


@pytest.mark.parametrize("change", [{"minimum_pixels": 0}, {"depth_noise": -1.0}, {"grazing_angle": 95.0}])
def test_settings_out_of_range_are_refused(change: dict) -> None:
    with pytest.raises(ConfigError, match=next(iter(change))):
        PerceptionConfig(**change)
