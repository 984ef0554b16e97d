"""The support plane: right on plain tables, and not fooled by walls, floors and box tops."""

import numpy as np
import pytest
from conftest import OBJECTS, Shape, Tabletop, make_tabletop

from perception import PerceptionConfig
from perception.observation import SupportPlane
from perception.support_plane import find_support_plane

WALL = Shape("box", (0.02, 3.0, 2.0), (0.32, 0.0, 0.6))
FLOOR = Shape("box", (6.0, 6.0, 0.02), (0.0, 0.0, -0.75))


def plane_of(scene: Tabletop, labels: np.ndarray | None, seed: int = 0) -> SupportPlane | None:
    frame = scene.frame
    points = frame.camera.back_project(frame.depth)
    return find_support_plane(points, labels, PerceptionConfig(), np.random.default_rng(seed))


def assert_is_table(scene: Tabletop, plane: SupportPlane | None, height: float = 0.0) -> None:
    """The plane is z = height of the world to 1 degree and 3 mm, and faces the camera."""
    assert plane is not None
    T = scene.frame.camera.T_world_camera
    normal = T[:3, :3] @ plane.normal
    assert np.degrees(np.arccos(np.clip(normal[2], -1, 1))) < 1.0
    # A point of the plane under the objects: the world's origin, expressed in the camera frame.
    below = T[:3, :3].T @ (np.array([0.0, 0.0, height]) - T[:3, 3])
    assert abs(plane.normal @ below + plane.offset) < 0.003
    assert plane.offset > 0


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("noise", [0.0, 0.003])
def test_plain_table(noise: float, seed: int) -> None:
    scene = make_tabletop(noise=noise, seed=seed)
    plane = plane_of(scene, scene.frame.labels, seed)
    assert_is_table(scene, plane)
    assert plane is not None
    assert plane.inlier_ratio > 0.9


@pytest.mark.parametrize("seed", range(3))
def test_a_large_wall_close_behind_is_no_support(seed: int) -> None:
    scene = make_tabletop(background=(WALL,), eye=(-0.75, 0.0, 0.25), noise=0.0015, seed=seed)
    assert_is_table(scene, plane_of(scene, scene.frame.labels, seed))


@pytest.mark.parametrize("seed", range(3))
def test_a_small_table_over_a_large_floor(seed: int) -> None:
    scene = make_tabletop(background=(FLOOR,), table=(0.42, 0.48), noise=0.0015, seed=seed)
    plane = plane_of(scene, scene.frame.labels, seed)
    assert_is_table(scene, plane)
    assert plane is not None
    assert plane.inlier_ratio < 0.6  # there is more floor than table to be seen


def test_the_top_of_an_unlabelled_box_is_no_support() -> None:
    shapes = (*OBJECTS, Shape("box", (0.30, 0.40, 0.10), (-0.05, 0.45, 0.05)))
    scene = make_tabletop(shapes, noise=0.0015)
    labels = np.where(scene.frame.labels == 5, 0, scene.frame.labels)
    assert_is_table(scene, plane_of(scene, labels))


def test_objects_on_a_box_stand_on_the_box() -> None:
    tray = Shape("box", (0.45, 0.50, 0.08), (0.0, 0.0, 0.04))
    raised = tuple(Shape(s.kind, s.size, (*s.position[:2], s.position[2] + 0.08), s.yaw) for s in OBJECTS)
    scene = make_tabletop((*raised, tray), noise=0.0015)
    labels = np.where(scene.frame.labels == 5, 0, scene.frame.labels)
    assert_is_table(scene, plane_of(scene, labels), height=0.08)


def test_little_table_in_sight() -> None:
    scene = make_tabletop(noise=0.0015)
    near = np.zeros(scene.frame.depth.shape, bool)
    rows, columns = np.nonzero(scene.frame.labels)
    near[rows.min() : rows.max() + 8, columns.min() - 4 : columns.max() + 4] = True
    depth = np.where(near, scene.frame.depth, np.nan)
    points = scene.frame.camera.back_project(depth)
    plane = find_support_plane(points, scene.frame.labels, PerceptionConfig(), np.random.default_rng(0))
    assert_is_table(scene, plane)


def test_masks_that_cover_the_whole_table() -> None:
    scene = make_tabletop(noise=0.0015)
    labels = np.ones_like(scene.frame.labels)
    assert_is_table(scene, plane_of(scene, labels))


def test_without_labels_the_table_is_preferred_to_the_floor() -> None:
    scene = make_tabletop(background=(FLOOR,), table=(0.50, 0.60), noise=0.0015)
    assert_is_table(scene, plane_of(scene, None))


def test_a_ball_in_the_void_has_no_support() -> None:
    scene = make_tabletop((Shape("sphere", (0.15,), (0.0, 0.0, 0.15)),), noise=0.0015)
    depth = np.where(scene.true_labels == 1, scene.frame.depth, np.nan)
    points = scene.frame.camera.back_project(depth)
    config = PerceptionConfig()
    assert find_support_plane(points, scene.true_labels, config, np.random.default_rng(0)) is None
