"""The overview: sizes, what each panel shows, and that the slice lies where it says."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from PIL import Image
from solids import BALL, BALL_RADIUS, reconstructed_tabletop, true_meshes

from perception.camera import invert_rigid, transform
from perception.observation import Skipped
from reconstruction.pictures.overview import WIDTH, _scale_bar, compose_overview, draw_overview
from reconstruction.pictures.palette import object_colour, uncertainty_colours
from reconstruction.pictures.slices import SliceConfig, _shared_height, slice_uncertainty, table_axes
from reconstruction.pictures.tags import place


@pytest.fixture(scope="module")
def reconstruction():
    return reconstructed_tabletop()


def test_picture_is_written_whole_and_holds_the_objects_colours(reconstruction, tmp_path):
    path = tmp_path / "overview.png"
    draw_overview(reconstruction, path, true_meshes())
    picture = np.asarray(Image.open(path))
    assert picture.shape[1] == WIDTH
    assert 700 < picture.shape[0] < 1200
    assert [p.name for p in tmp_path.iterdir()] == ["overview.png"]
    for item in reconstruction.objects:  # the legend shows each colour unshaded
        assert (picture == object_colour(item.class_index - 1)).all(axis=2).sum() > 100


def test_photo_shows_depth_where_there_is_no_colour_image(reconstruction):
    grey = dataclasses.replace(reconstruction, frame=dataclasses.replace(reconstruction.frame, rgb=None))
    a, b = np.asarray(compose_overview(reconstruction)), np.asarray(compose_overview(grey))
    third = WIDTH // 3
    assert (a[:400, :third] != b[:400, :third]).any()
    assert (a[:, third + 20 :] == b[:, third + 20 :]).all()


def test_skipped_objects_and_hostile_names_are_drawn(reconstruction):
    objects = tuple(
        dataclasses.replace(item, name="\x00名前/../" + "x" * 300) for item in reconstruction.objects
    )
    odd = dataclasses.replace(
        reconstruction, objects=objects, skipped=(Skipped(9, "tiny", "12 valid pixels, 30 needed"),)
    )
    plain, with_skipped = compose_overview(reconstruction), compose_overview(odd)
    assert with_skipped.height > plain.height


def test_slice_agrees_with_the_map_at_the_places_it_names(reconstruction):
    section = slice_uncertainty(reconstruction, SliceConfig(columns=40))
    for row, column in ((0, 0), (10, 25), (section.values.shape[0] - 1, 39)):
        world = section.origin + row * section.down + column * section.right
        assert section.values[row, column] == pytest.approx(
            reconstruction.query(world[None]).uncertainty[0], abs=1e-4
        )


def test_slice_is_horizontal_at_its_height_with_the_far_side_on_top(reconstruction):
    section = slice_uncertainty(reconstruction, SliceConfig(columns=40))
    table = transform(invert_rigid(reconstruction.T_world_table), section.corners)
    np.testing.assert_allclose(table[:, 2], section.height, atol=1e-6)
    assert np.linalg.norm(section.down) == pytest.approx(section.spacing)
    eye = reconstruction.frame.camera.T_world_camera[:3, 3]
    assert np.linalg.norm(section.corners[0] - eye) > np.linalg.norm(section.corners[3] - eye)


def test_outline_of_a_ball_is_the_circle_of_that_height(reconstruction):
    section = slice_uncertainty(reconstruction, SliceConfig(columns=60))
    ball = true_meshes()[BALL]
    segments = section.outline(ball)
    world = section.origin + segments[..., :1] * section.right + segments[..., 1:] * section.down
    np.testing.assert_allclose(np.linalg.norm(world - ball.bounds.mean(0), axis=2), BALL_RADIUS, atol=0.001)
    assert len(segments) > 20


def test_without_a_support_plane_up_is_the_cameras(reconstruction):
    observation = dataclasses.replace(reconstruction.observation, support=None)
    camera_frame = dataclasses.replace(
        reconstruction, observation=observation, T_world_table=reconstruction.frame.camera.T_world_camera
    )
    R = reconstruction.frame.camera.T_world_camera[:3, :3]
    np.testing.assert_allclose(table_axes(camera_frame), [R[:, 2], -R[:, 0], -R[:, 1]])


def test_uncertainty_colours_grow_lighter_and_clip():
    colours = uncertainty_colours(np.array([-1.0, 0.0, 0.3, 0.6, 1.0, 2.0])).astype(int)
    luma = colours @ [0.3, 0.59, 0.11]
    assert (colours[0] == colours[1]).all()
    assert (colours[-1] == colours[-2]).all()
    assert (np.diff(luma[1:5]) > 20).all()


def test_slice_height_cuts_as_many_objects_as_possible():
    low, high = np.array([0.0, 0.0, 0.0]), np.array([0.20, 0.24, 0.06])  # two tall, one flat
    assert _shared_height(low, high) == pytest.approx(0.03)
    assert _shared_height(np.array([0.0, 0.3]), np.array([0.1, 0.4])) in (0.05, 0.35)  # one above the other


def test_names_leave_small_objects_and_one_another_free():
    rng = np.random.default_rng(0)
    masks = []
    for corner in rng.uniform((20, 60), (330, 440), (9, 2)).astype(int):
        mask = np.zeros((381, 508), bool)
        mask[corner[0] : corner[0] + 14, corner[1] : corner[1] + 18] = True
        masks.append(mask)
    places = place(masks, [120.0] * len(masks))
    drawn = np.zeros((381, 508), int)
    for left, top, right, bottom in places:
        assert 0 <= left < right <= 508
        assert 0 <= top < bottom <= 381
        drawn[int(top) : int(bottom), int(left) : int(right)] += 1
    assert drawn.max() == 1
    assert all(drawn[mask].mean() < 0.1 for mask in masks)


@pytest.mark.parametrize("metres_per_pixel", [1e-5, 3e-4, 9e-4, 4e-3, 0.02])
def test_the_scale_bar_is_round_and_leaves_the_middle_free(metres_per_pixel):
    centimetres, width = _scale_bar(metres_per_pixel)
    assert width == pytest.approx(centimetres / 100 / metres_per_pixel)
    assert 40 < width <= 130
    assert float(f"{centimetres:e}".split("e")[0]) in (1, 2, 5)


@pytest.mark.parametrize(("tilt", "roll"), [(-12, 0), (12, 90)])
def test_from_above_the_pictures_are_turned_as_the_image_is(reconstruction, tilt, roll):
    from scipy.spatial.transform import Rotation

    down = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))
    pose = np.eye(4)
    pose[:3, :3] = (down * Rotation.from_euler("xz", [tilt, roll], degrees=True)).as_matrix()
    camera = dataclasses.replace(reconstruction.frame.camera, T_world_camera=pose)
    seen = dataclasses.replace(
        reconstruction,
        frame=dataclasses.replace(reconstruction.frame, camera=camera),
        T_world_table=np.eye(4),
    )
    away, left, up = table_axes(seen)
    np.testing.assert_allclose(up, [0, 0, 1], atol=1e-9)
    np.testing.assert_allclose(np.cross(up, away), left, atol=1e-9)
    assert away @ -pose[:3, 1] > 0.97  # the image's upward direction
    assert left @ -pose[:3, 0] > 0.97
