"""Objects cut by the image's border or seen from straight above: on their support, unsure where unseen."""

import dataclasses

import numpy as np
import pytest
from conftest import Shape, Tabletop, make_tabletop, shape_mesh
from trimesh import Trimesh

from perception import Camera, Frame, observe
from perception.camera import invert_rigid, transform
from reconstruction import reconstruct
from reconstruction.config import PipelineConfig
from reconstruction.fitted_scene import FittedScene
from reconstruction.metrics import mesh_iou
from reconstruction.samples.structure import BEHIND_OTHERS, lean_behind_others

CUT = 3
"""The cylinder, cut by the image's lower border."""
FAR = 4
"""A thing far from the middle of the image."""


def without_rows(frame: Frame, last: int) -> Frame:
    """The image above a row."""
    camera = Camera(frame.camera.K, frame.camera.width, last, frame.camera.T_world_camera)
    assert frame.labels is not None
    return Frame(frame.depth[:last], camera, None, frame.labels[:last], frame.names, trust=frozenset({"K"}))


def true_mesh(shape: Shape) -> Trimesh:
    legacy = shape_mesh(shape)
    return Trimesh(np.asarray(legacy.vertices), np.asarray(legacy.triangles))


def test_a_cut_object_stands_on_its_support_and_nothing_beyond_the_border_is_free(tabletop: Tabletop) -> None:
    rows = np.flatnonzero((tabletop.true_labels == CUT).any(1))
    frame = without_rows(tabletop.frame, int(rows[0] + 0.65 * len(rows)))
    result = reconstruct(frame)
    mesh = next(item.mesh for item in result.objects if item.label == CUT)
    true = true_mesh(tabletop.shapes[CUT - 1])
    assert mesh.bounds[0][2] < 0.005
    assert mesh_iou(mesh, true) > 0.7
    points = np.random.default_rng(0).uniform(*true.bounds, (4000, 3))
    local = transform(invert_rigid(frame.camera.T_world_camera), points)
    row = local[:, 1] / local[:, 2] * frame.camera.K[1, 1] + frame.camera.K[1, 2]
    beyond = points[row > frame.camera.height]
    assert len(beyond) > 500
    answer = result.query(beyond)
    assert not answer.free.any()
    assert answer.uncertainty.mean() > 0.5


def test_a_cut_far_from_the_middle_is_mapped_like_the_whole(tabletop: Tabletop) -> None:
    frame = tabletop.frame
    assert frame.labels is not None
    rows, columns = np.nonzero(frame.labels == FAR)
    top, left = int(rows.min()) - 20, int(columns.min()) - 20
    part = np.s_[top : int(rows.max()) + 20, left : int(columns.max()) + 20]
    K = frame.camera.K.copy()
    K[:2, 2] -= left, top
    depth, labels = frame.depth[part], frame.labels[part]
    camera = Camera(K, depth.shape[1], depth.shape[0], frame.camera.T_world_camera)
    assert not camera.sees_axis
    result = reconstruct(Frame(depth, camera, None, labels, frame.names))
    mesh = next(item.mesh for item in result.objects if item.label == FAR)
    assert mesh_iou(mesh, true_mesh(tabletop.shapes[FAR - 1])) > 0.7
    assert any("right for a cut image only" in note for note in result.notes)


def test_a_jug_seen_from_straight_above_is_as_wide_as_its_top() -> None:
    tall = Shape("cylinder", (0.05, 0.22), (0.10, 0.05, 0.11))
    handle = Shape("box", (0.05, 0.02, 0.03), (0.17, 0.05, 0.18))
    scene = make_tabletop((tall, handle), eye=(0.0, 0.0, 0.8), target=(0.0, 0.0, 0.0))
    assert scene.frame.labels is not None
    labels = np.where(scene.frame.labels == 2, 1, scene.frame.labels).astype(np.uint16)
    (item,) = reconstruct(dataclasses.replace(scene.frame, labels=labels)).objects
    assert item.mesh.bounds[0][2] < 0.005
    assert mesh_iou(item.mesh, true_mesh(tall)) > 0.8


def test_a_thing_seen_from_above_on_another_does_not_go_through_it() -> None:
    tall, ball = (
        Shape("box", (0.12, 0.14, 0.20), (0.05, 0.0, 0.10)),
        Shape("sphere", (0.02,), (0.04, 0, 0.22)),
    )
    scene = make_tabletop((tall, ball), eye=(0.0, 0.0, 0.9), target=(0.0, 0.0, 0.0))
    carrier, carried = (item.mesh for item in reconstruct(scene.frame).objects)
    assert carrier.bounds[0][2] < 0.005
    assert carried.bounds[0][2] > 0.17


@pytest.mark.parametrize("tilt", [0.0, 0.02])
def test_a_table_without_slant_tells_no_kind_of_depth(tilt: float) -> None:
    scene = make_tabletop(eye=(-tilt, 0.0, 0.8), target=(0.0, 0.0, 0.0))
    assert len(observe(scene.frame).objects) == 4


def test_what_another_object_hides_counts_more_and_what_an_object_hides_itself_does_not() -> None:
    boxes = (
        Shape("box", (0.05, 0.1, 0.08), (0.0, 0.0, 0.04)),
        Shape("box", (0.05, 0.2, 0.04), (0.1, 0.0, 0.02)),
    )
    scene = FittedScene.of(make_tabletop(boxes).frame, PipelineConfig())
    own, other = scene.observation.objects
    hidden = own.points[:: 1 + len(own.points) // 50] + np.float32([0.02, 0, -0.01])
    plain = np.tile(np.float32([0.5, 0.3, 0.2]), (len(hidden), 1))
    guess = plain.copy()
    lean_behind_others(scene.observation, scene.space, hidden, guess)
    np.testing.assert_allclose(guess.sum(1), 1, atol=1e-6)
    behind = scene.space.pixel_of(hidden)
    of_own = np.isin(behind, own.pixels)
    assert of_own.mean() > 0.3
    np.testing.assert_allclose(guess[of_own, 1] / guess[of_own, 0], 0.3 / 0.5, rtol=1e-5)
    np.testing.assert_allclose(guess[of_own, 2] / guess[of_own, 0], BEHIND_OTHERS * 0.2 / 0.5, rtol=1e-5)
    elsewhere = ~of_own & ~np.isin(behind, other.pixels)
    assert elsewhere.any()
    np.testing.assert_array_equal(guess[elsewhere], plain[elsewhere])
