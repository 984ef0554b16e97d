"""Space: what one frame says of any points, against ray casts of the true scene."""

import dataclasses

import numpy as np
import pytest
from conftest import Tabletop, make_tabletop

from perception import Camera, Observation, Region, Space, observe
from perception.camera import invert_rigid, transform


@pytest.fixture(scope="module")
def scene() -> Tabletop:
    return make_tabletop()


@pytest.fixture(scope="module")
def observation(scene: Tabletop) -> Observation:
    return observe(scene.frame)


@pytest.fixture(scope="module")
def space(observation: Observation) -> Space:
    return Space.of(observation)


def random_points(count: int, seed: int = 0) -> np.ndarray:
    generator = np.random.default_rng(seed)
    return generator.uniform([-0.3, -0.3, -0.1], [0.3, 0.3, 0.4], (count, 3)).astype(np.float32)


def test_agrees_with_ray_casts(scene: Tabletop, observation: Observation, space: Space) -> None:
    import open3d as o3d

    points = random_points(20_000)
    T_world_table = scene.frame.camera.T_world_camera @ invert_rigid(observation.T_table_camera)
    world = transform(T_world_table, points)
    eye = T_world_table[:3, :3] @ space.origin + T_world_table[:3, 3]
    np.testing.assert_allclose(eye, scene.frame.camera.T_world_camera[:3, 3], atol=1e-6)
    rays = np.concatenate([np.broadcast_to(eye.astype(np.float32), world.shape), world - eye], axis=1)
    hit = scene.scene.cast_rays(o3d.core.Tensor(rays.astype(np.float32)))["t_hit"].numpy()
    distance = scene.scene.compute_distance(o3d.core.Tensor(world)).numpy()
    region = space.classify(points)
    # Near surfaces and silhouettes, pixels and exact rays may differ; elsewhere they must not.
    clear = (distance > 0.02) & (region != Region.OUT_OF_VIEW) & (region != Region.BELOW_SUPPORT)
    assert clear.sum() > 3_000
    expected = np.where(hit < 1, Region.OCCLUDED, Region.FREE)
    assert (region[clear] == expected[clear]).mean() > 0.985
    assert set(np.unique(expected[clear])) == {Region.FREE, Region.OCCLUDED}


def test_measured_points_lie_on_the_surface(observation: Observation, space: Space) -> None:
    for item in observation.objects:
        region = space.classify(item.points)
        assert (region == Region.SURFACE).all()
        np.testing.assert_array_equal(space.pixel_of(item.points), item.pixels)
        np.testing.assert_allclose(space.depth_behind(item.points), 0, atol=1e-5)


def test_depth_behind_is_measured_along_z(observation: Observation, space: Space) -> None:
    item = observation.objects[0]
    T_camera_table = invert_rigid(observation.T_table_camera)
    along = transform(T_camera_table, item.points)
    deeper = transform(observation.T_table_camera, along * ((along[:, 2:] + 0.05) / along[:, 2:]))
    np.testing.assert_allclose(space.depth_behind(deeper), 0.05, atol=1e-4)
    above = deeper[:, 2] > 0
    assert (space.classify(deeper)[above] == Region.OCCLUDED).all()


def test_outside_the_image_and_behind_the_camera_is_out_of_view(space: Space) -> None:
    forward = -space.origin / np.linalg.norm(space.origin)
    behind = (space.origin - 0.3 * forward)[None].astype(np.float32)
    aside = np.array([[0.0, 5.0, 0.1], [0.0, -5.0, 0.1], [0.2, 0.0, 9.0]], np.float32)
    points = np.concatenate([behind, aside, space.origin[None].astype(np.float32)])
    assert (space.classify(points) == Region.OUT_OF_VIEW).all()
    assert (space.pixel_of(points) == -1).all()
    assert np.isnan(space.depth_behind(points)).all()


def test_pixels_without_depth_say_nothing(observation: Observation) -> None:
    item = observation.objects[0]
    depth = observation.depth.copy()
    depth.reshape(-1)[item.pixels] = np.nan
    space = Space.of(dataclasses.replace(observation, depth=depth))
    assert (space.classify(item.points) == Region.OUT_OF_VIEW).all()
    np.testing.assert_array_equal(space.pixel_of(item.points), item.pixels)


def test_under_the_support_plane(observation: Observation, space: Space) -> None:
    points = random_points(2_000)
    region = space.classify(points)
    np.testing.assert_array_equal(region == Region.BELOW_SUPPORT, points[:, 2] < -0.004)
    without = Space.of(dataclasses.replace(observation, support=None)).classify(points)
    assert not (without == Region.BELOW_SUPPORT).any()


@pytest.mark.parametrize("count", [0, 1, 16_384, 16_385])
def test_any_number_of_points(space: Space, count: int) -> None:
    points = random_points(count)
    region = space.classify(points)
    assert region.shape == (count,)
    assert region.dtype == np.int8
    one_by_one = [space.classify(point[None])[0] for point in points[-5:]]
    np.testing.assert_array_equal(region[-5:], one_by_one)


def test_pixels_agree_with_the_camera(observation: Observation, space: Space) -> None:
    camera: Camera = observation.camera
    points = random_points(5_000)
    uv, z = camera.project(transform(invert_rigid(observation.T_table_camera), points.astype(np.float64)))
    inside = (z > 0) & (uv > -0.49).all(1) & (uv < np.array([camera.width, camera.height]) - 0.51).all(1)
    expected = np.rint(uv[:, 1]) * camera.width + np.rint(uv[:, 0])
    tie = (np.abs(uv % 1 - 0.5) < 1e-3).any(1)
    np.testing.assert_array_equal(space.pixel_of(points)[inside & ~tie], expected[inside & ~tie])
    outside = (uv < -0.51).any(1) | (uv > np.array([camera.width, camera.height]) - 0.49).any(1)
    assert (space.pixel_of(points)[outside] == -1).all()


def test_points_of_another_shape_are_refused(space: Space) -> None:
    with pytest.raises(ValueError, match="shape"):
        space.classify(np.zeros((4, 2), np.float32))


def test_near_objects_agrees_with_distances_to_boxes(observation: Observation) -> None:
    points = random_points(40_000)  # more than a block
    expected = np.zeros(len(points), bool)
    for item in observation.objects:
        low, high = item.bounds
        gap = np.maximum(np.maximum(low - points, points - high), 0)
        expected |= np.linalg.norm(gap, axis=1) < 0.03
    assert 0 < expected.sum() < len(points)
    np.testing.assert_array_equal(observation.near_objects(points, 0.03), expected)
