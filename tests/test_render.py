"""Rendered frames agree with the geometry they were rendered from."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from perception.camera import Camera, look_at, transform
from reconstruction import metrics
from sim_scenes.objects import builtin
from sim_scenes.objects.object_model import ObjectModel, corner_normals
from sim_scenes.render import CameraConfig, Renderer, random_cameras
from sim_scenes.surroundings import Surroundings
from sim_scenes.tabletop import PlacedObject

TABLE = (1.6, 1.2)
SMALL = CameraConfig(width=160, height=120, focal_px=150.0)


def placed(family: str, x: float, y: float, seed: int = 0) -> PlacedObject:
    model = builtin.make(family, np.random.default_rng(seed))
    T = np.eye(4)
    T[:3, 3] = [x, y, -model.mesh.bounds[0, 2]]
    return PlacedObject(model, T)


@pytest.fixture(scope="module")
def scene() -> list[PlacedObject]:
    return [placed("box", 0.0, 0.08), placed("cup", 0.12, -0.05), placed("ball", -0.12, -0.02)]


@pytest.fixture(scope="module")
def renderer(scene: list[PlacedObject]) -> Renderer:
    return Renderer(scene, Surroundings.random(TABLE, np.random.default_rng(0)))


@pytest.fixture(scope="module")
def camera() -> Camera:
    return random_cameras(1, np.array([0, 0, 0.04]), np.random.default_rng(0))[0]


def test_labelled_pixels_lie_on_the_true_mesh(
    scene: list[PlacedObject], renderer: Renderer, camera: Camera
) -> None:
    depth, labels = renderer.depth_and_labels(camera)
    points = transform(camera.T_world_camera, camera.back_project(depth))
    for label, item in enumerate(scene, start=1):
        mesh = item.model.mesh.copy()
        mesh.apply_transform(item.T_world_object)
        seen = points[labels == label]
        assert len(seen) > 200
        assert metrics.distance_to_surface(mesh, seen).max() < 1e-4


def test_table_pixels_lie_on_the_plane(renderer: Renderer, camera: Camera) -> None:
    depth, labels = renderer.depth_and_labels(camera)
    points = transform(camera.T_world_camera, camera.back_project(depth))[labels == 0]
    above_table = (np.abs(points[:, 0]) < TABLE[0] / 2 - 0.01) & (np.abs(points[:, 1]) < TABLE[1] / 2 - 0.01)
    heights = points[above_table & (points[:, 2] > -0.5), 2]
    assert len(heights) > 50_000
    assert np.abs(heights).max() < 1e-4


def test_cameras_look_at_the_target_from_where_they_may_stand() -> None:
    target, config = np.array([0.1, -0.05, 0.04]), CameraConfig()
    for camera in random_cameras(5, target, np.random.default_rng(3), config):
        eye = camera.T_world_camera[:3, 3] - target
        distance = np.linalg.norm(eye)
        assert config.distance_m[0] <= distance <= config.distance_m[1]
        elevation = np.rad2deg(np.arcsin(eye[2] / distance))
        assert config.elevation_deg[0] - 1e-6 <= elevation <= config.elevation_deg[1] + 1e-6
        in_camera = np.linalg.inv(camera.T_world_camera) @ [*target, 1]
        pixel, depth = camera.project(in_camera[None, :3])
        np.testing.assert_allclose(pixel[0], [319.5, 239.5], atol=1e-6)
        assert depth[0] == pytest.approx(distance)
        assert camera.T_world_camera[2, 1] < 0  # image rows run downwards in the world


def test_images_show_colour_light_and_shadow(renderer: Renderer) -> None:
    camera = random_cameras(1, np.array([0, 0, 0.04]), np.random.default_rng(0), SMALL)[0]
    image = renderer.rgb(camera, np.random.default_rng(0))
    again = renderer.rgb(camera, np.random.default_rng(0))
    np.testing.assert_array_equal(image, again)
    assert image.dtype == np.uint8
    assert image.shape == (120, 160, 3)
    assert 60 < image.mean() < 230
    assert (image == 0).all(axis=-1).mean() < 0.01  # no black holes
    assert (image == 255).all(axis=-1).mean() < 0.05


def test_shadows_darken_the_table_beside_an_object() -> None:
    camera = Camera(
        np.array([[150.0, 0, 79.5], [0, 150, 59.5], [0, 0, 1]]),
        160,
        120,
        look_at(np.array([0, -0.3, 0.9]), np.zeros(3)),
    )
    plain = Surroundings.plain(TABLE)
    empty = Renderer([], plain).rgb(camera, np.random.default_rng(0)).astype(float)
    full_renderer = Renderer([placed("box", 0, 0)], plain)
    full = full_renderer.rgb(camera, np.random.default_rng(0)).astype(float)
    _, labels = full_renderer.depth_and_labels(camera)
    change = (full - empty).mean(axis=-1)[labels == 0]
    assert change.min() < -30  # the shadow
    assert abs(np.median(change)) < 3  # the rest stays as it was


def test_textures_appear_where_they_belong() -> None:
    square = trimesh.Trimesh([[0, 0, 0], [0.2, 0, 0], [0.2, 0.2, 0], [0, 0.2, 0]], [[0, 1, 2], [0, 2, 3]])
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)[square.faces]
    texture = np.zeros((64, 64, 3), np.uint8)
    texture[:32, :, 0] = 220  # upper half of the picture red, which is v > 0.5
    texture[32:, :, 2] = 220
    model = ObjectModel("card", "builtin", square, corner_uv=uv, texture=texture)
    T = np.eye(4)
    T[:3, 3] = [-0.1, -0.1, 0.001]
    camera = Camera(
        np.array([[150.0, 0, 79.5], [0, 150, 59.5], [0, 0, 1]]),
        160,
        120,
        look_at(np.array([0, -0.05, 0.5]), np.zeros(3)),
    )
    image = Renderer([PlacedObject(model, T)], Surroundings.plain(TABLE)).rgb(
        camera, np.random.default_rng(0)
    )
    far, near = image[40, 80].astype(int), image[78, 80].astype(int)  # y > 0 is farther away
    assert far[0] > far[2] + 50
    assert near[2] > near[0] + 50


def test_normals_are_sharp_on_cubes_and_smooth_on_balls() -> None:
    cube = trimesh.creation.box()
    np.testing.assert_allclose(
        corner_normals(cube), np.repeat(cube.face_normals[:, None], 3, axis=1), atol=1e-6
    )
    ball = trimesh.creation.icosphere(subdivisions=3)
    directions = ball.vertices[ball.faces] / np.linalg.norm(ball.vertices[ball.faces], axis=-1, keepdims=True)
    assert (corner_normals(ball) * directions).sum(axis=-1).min() > 0.999
