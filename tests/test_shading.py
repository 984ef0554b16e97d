"""Shading: what the picture shows is where the geometry says it is, in the colours given."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy import ndimage

from reconstruction.pictures.shading import ShadingConfig, cast, frame_meshes, render, viewing_camera

UP = np.array([0.0, 0.0, 1.0])
SIZE = (160, 120)


@pytest.fixture
def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=4, radius=0.1)


def test_ball_covers_the_disc_that_projection_predicts(ball):
    camera = viewing_camera(np.array([-1.0, 0, 0]), np.zeros(3), UP, SIZE, field_of_view=20)
    view = cast([ball], camera)
    tangent = np.tan(np.arcsin(0.1 / 1.0))  # the silhouette of a ball at 1 m
    radius = tangent * camera.K[0, 0] * ShadingConfig().supersampling
    assert view.hit.sum() == pytest.approx(np.pi * radius**2, rel=0.02)
    rows, columns = np.nonzero(view.hit)
    assert rows.mean() == pytest.approx((view.hit.shape[0] - 1) / 2, abs=0.6)
    assert columns.mean() == pytest.approx((view.hit.shape[1] - 1) / 2, abs=0.6)


def test_vertex_colours_are_interpolated_across_a_triangle():
    triangle = trimesh.Trimesh([[0, -1, -1], [0, 1, -1], [0, 0, 1]], [[0, 1, 2]], process=False)
    colours = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255]])
    camera = viewing_camera(np.array([-3.0, 0, 0]), np.zeros(3), UP, SIZE, field_of_view=50)
    picture = render([triangle], [colours], camera).astype(float)
    shares = picture / picture.sum(axis=2, keepdims=True)
    centroid, _ = camera.project(_in_camera(camera, np.array([[0, 0, -1 / 3]])))
    u, v = np.round(centroid[0]).astype(int)
    np.testing.assert_allclose(shares[v, u], 1 / 3, atol=0.03)
    near_top, _ = camera.project(_in_camera(camera, np.array([[0, 0, 0.8]])))
    u, v = np.round(near_top[0]).astype(int)
    np.testing.assert_allclose(shares[v, u], [0.05, 0.05, 0.9], atol=0.04)


def test_nearer_mesh_hides_the_farther(ball):
    far = ball.copy()
    far.apply_translation([0.5, 0, 0])
    camera = viewing_camera(np.array([-1.0, 0, 0]), np.zeros(3), UP, SIZE, field_of_view=20)
    view = cast([far, ball], camera)
    middle = view.mesh[view.mesh.shape[0] // 2, view.mesh.shape[1] // 2]
    assert middle == 1


@pytest.mark.parametrize("direction", [(1, 0, -0.4), (-0.3, 0.8, -0.6), (0.1, 0.1, -1)])
def test_framed_camera_holds_every_vertex_and_fills_the_picture(ball, direction):
    box = trimesh.creation.box((0.3, 0.1, 0.2))
    box.apply_translation([0.2, 0.4, 0.1])
    camera = frame_meshes([ball, box], np.array(direction), UP, SIZE)
    points = np.concatenate([ball.vertices, box.vertices])
    pixels, depth = camera.project(_in_camera(camera, points))
    assert (depth > 0).all()
    assert (pixels >= 0).all()
    assert (pixels <= np.array(SIZE) - 1).all()
    extent = (np.ptp(pixels, axis=0) / SIZE).max()
    assert 0.75 < extent < 1


def test_ground_shows_a_shadow_only_when_asked(ball):
    ball.apply_translation([0, 0, 0.1])
    camera = frame_meshes([ball], np.array([1, 0, -0.7]), UP, SIZE, margin=2.0)
    colours = [np.full((len(ball.vertices), 3), 128)]
    background = np.array(ShadingConfig().background)
    without = render([ball], colours, camera)
    shadowed = render([ball], colours, camera, ground=(UP, 0.0))
    empty = ~cast([ball], camera).hit[::2, ::2]
    interior = ndimage.binary_erosion(empty, iterations=3)
    assert (without[interior] == background).all()
    darker = (shadowed[interior].sum(1) < background.sum() - 60).mean()
    assert 0.005 < darker < 0.3


def test_edges_are_smoothed(ball):
    camera = viewing_camera(np.array([-1.0, 0, 0]), np.zeros(3), UP, SIZE, field_of_view=20)
    black = [np.zeros((len(ball.vertices), 3))]
    picture = render([ball], black, camera)
    values = np.unique(picture[..., 0])
    assert values[0] == 0
    assert values[-1] == ShadingConfig().background[0]
    assert len(values) >= 4  # partly covered pixels lie between


def _in_camera(camera, points):
    T = camera.T_world_camera
    return (points - T[:3, 3]) @ T[:3, :3]
