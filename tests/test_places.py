"""Places that are no bare table: glass, a bin, a tray, shelves. Nothing hovers or grows through its board."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from conftest import Shape, Tabletop, make_tabletop, shape_mesh
from trimesh import Trimesh

from perception import Frame, observe
from perception.carried import beds
from reconstruction import Reconstruction, reconstruct
from reconstruction.metrics import mesh_iou

BOX = Shape("box", (0.06, 0.09, 0.16), (0.05, 0.08, 0.08), 0.4)
CAN = Shape("cylinder", (0.035, 0.10), (-0.06, -0.08, 0.05))
BALL = Shape("sphere", (0.04,), (0.09, -0.09, 0.04))
THINGS = (BOX, CAN, BALL)
FLOOR = Shape("box", (4.0, 4.0, 0.02), (0.6, 0.0, -0.71))
WALLS = (
    Shape("box", (0.5, 0.01, 0.12), (0.0, 0.22, 0.06)),
    Shape("box", (0.5, 0.01, 0.12), (0.0, -0.22, 0.06)),
    Shape("box", (0.01, 0.44, 0.12), (0.25, 0.0, 0.06)),
    Shape("box", (0.01, 0.44, 0.12), (-0.25, 0.0, 0.06)),
)
TRAY = Shape("box", (0.36, 0.40, 0.03), (0.02, 0.0, 0.015))
UPPER = Shape("box", (0.35, 0.9, 0.02), (0.05, 0.0, 0.39))
BACK = Shape("box", (0.02, 0.9, 1.2), (0.25, 0.0, 0.3))


def raised(shape: Shape, by: float) -> Shape:
    x, y, z = shape.position
    return dataclasses.replace(shape, position=(x, y, z + by))


def check(result: Reconstruction, scene: Tabletop, labels: set[int], least: float) -> None:
    """Objects stand on what is under them, to 5 mm, and have the shape of the true ones."""
    meshes = {item.label: item.mesh for item in result.objects}
    assert labels <= set(meshes)
    for label in labels:
        legacy = shape_mesh(scene.shapes[label - 1])
        true = Trimesh(np.asarray(legacy.vertices), np.asarray(legacy.triangles))
        assert abs(meshes[label].bounds[0][2] - true.bounds[0][2]) < 0.005, label
        assert mesh_iou(meshes[label], true) > least, label


def without_table(scene: Tabletop) -> Frame:
    return dataclasses.replace(
        scene.frame, depth=np.where(scene.true_labels == 0, np.nan, scene.frame.depth).astype(np.float32)
    )


def test_a_glass_table_is_no_support_and_no_side_of_a_thing_is_taken_for_it() -> None:
    scene = make_tabletop(THINGS, noise=0.001)
    result = reconstruct(without_table(scene))
    assert result.observation.support is None
    assert any("no support plane" in note for note in result.notes)
    for item in result.objects:
        legacy = shape_mesh(scene.shapes[item.label - 1])
        low, high = legacy.get_min_bound(), legacy.get_max_bound()
        # The back is a guess; nothing lies where masks say that no object is.
        assert (item.mesh.bounds[1] < high + np.array([0.03, 0.025, 0.015])).all()
        assert (item.mesh.bounds[0] > low - 0.025).all()
        assert result.agreement[item.label].agreement > 0.9


def test_the_floor_under_a_glass_table_is_no_support() -> None:
    scene = make_tabletop(THINGS, noise=0.001, table=(0.002, 0.002), background=(FLOOR,))
    result = reconstruct(scene.frame)
    assert result.observation.support is None
    assert all(item.mesh.bounds[0][2] > -0.03 for item in result.objects)


def test_things_in_a_bin_stand_on_its_bottom() -> None:
    scene = make_tabletop(THINGS, noise=0.001, background=WALLS, eye=(-0.45, 0.0, 0.75))
    result = reconstruct(scene.frame)
    check(result, scene, {1, 2, 3}, 0.8)
    assert result.other is not None  # the walls


def test_things_on_a_tray_stand_on_the_tray() -> None:
    scene = make_tabletop(tuple(raised(item, 0.03) for item in THINGS), noise=0.001, background=(TRAY,))
    check(reconstruct(scene.frame), scene, {1, 2, 3}, 0.8)


def test_things_on_a_labelled_tray_end_at_its_top() -> None:
    scene = make_tabletop((*(raised(shape, 0.03) for shape in THINGS), TRAY), noise=0.001, size=(240, 180))
    result = reconstruct(scene.frame)
    check(result, scene, {1, 2, 3}, 0.75)
    assert result.floor is not None
    assert result.floor < 0


def test_what_stands_behind_a_box_does_not_hover() -> None:
    low = Shape("box", (0.06, 0.20, 0.10), (-0.02, 0.0, 0.05))
    behind = Shape("cylinder", (0.035, 0.16), (0.08, 0.0, 0.08))
    scene = make_tabletop((low, behind), noise=0.001, size=(240, 180))
    check(reconstruct(scene.frame), scene, {1, 2}, 0.7)


def test_what_stands_close_behind_a_box_does_not_lie_on_it() -> None:
    low = Shape("box", (0.12, 0.20, 0.06), (-0.10, 0.0, 0.03))
    behind = Shape("box", (0.06, 0.09, 0.16), (0.0, 0.0, 0.08))
    on_top = Shape("box", (0.05, 0.05, 0.04), (-0.09, 0.03, 0.08))
    objects = observe(make_tabletop((low, behind, on_top), noise=0.001).frame).objects
    found = {item.label: bed for item, bed in zip(objects, beds(objects))}
    assert found[1] is None
    assert found[2] is None
    assert found[3] == pytest.approx(0.06, abs=0.003)


def test_the_back_of_a_shelf_is_no_support() -> None:
    shapes = (BOX, CAN, raised(BOX, 0.40))
    scene = make_tabletop(
        shapes,
        noise=0.001,
        table=(0.35, 0.9),
        background=(UPPER, BACK),
        eye=(-1.1, 0.1, 0.30),
        target=(0.05, 0.0, 0.2),
    )
    result = reconstruct(scene.frame)
    check(result, scene, {1, 2}, 0.65)
    # The camera is lower than the upper board: the foot on it is hidden.
    (upper,) = (item.mesh for item in result.objects if item.label == 3)
    assert 0.39 < upper.bounds[0][2] < 0.42
