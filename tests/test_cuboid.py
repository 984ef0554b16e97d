"""Cuboids: which things are taken for one, how well their hidden sides are known, what becomes of them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import ClassVar

import numpy as np
import pytest
from conftest import Shape, make_tabletop

from perception.observing import observe
from reconstruction.config import FusionConfig, MeshConfig, PipelineConfig
from reconstruction.fitted_scene import FittedScene
from reconstruction.samples.bodies import SURE, with_bodies
from reconstruction.scene import reconstruct
from reconstruction.surface.boxed import BoxedEdges
from reconstruction.surface.cuboid import Cuboid
from reconstruction.surface.revolved import RevolvedEdges
from reconstruction.surface.whole_shape import whole_shape

SIZE = np.array([0.06, 0.10, 0.12])
CARTON = Shape("box", tuple(SIZE), (0.0, 0.0, 0.06), 0.4)
BEFORE = Shape("box", (0.02, 0.3, 0.05), (-0.12, 0.0, 0.025))
"""Hides the lower part of the carton; the camera looks along x."""
CARRIED = Shape("box", (0.06, 0.10, 0.04), (0.0, 0.0, 0.10), 0.4)
CARRIER = Shape("box", (0.14, 0.16, 0.08), (0.0, 0.0, 0.04), 0.4)
SCENES = {
    "carton": (CARTON,),
    "carton behind something": (CARTON, BEFORE),
    "carton on another": (CARRIED, CARRIER),
    "can": (Shape("cylinder", (0.04, 0.12), (0.03, 0.02, 0.06)),),
    "ball": (Shape("sphere", (0.04,), (0.0, 0.03, 0.04)),),
    "wall": (Shape("box", (0.06, 0.9, 0.30), (0.0, 0.0, 0.15)),),
}


@cache
def boxed(name: str) -> BoxedEdges | None:
    shape = FittedScene.of(make_tabletop(SCENES[name]).frame, PipelineConfig()).shapes[0]
    return shape if isinstance(shape, BoxedEdges) else None


def sides(cuboid: Cuboid) -> np.ndarray:
    """Two level sides, the shorter one first, and the height [m]."""
    size, upright = cuboid.high - cuboid.low, np.abs(cuboid.axes[:, 2]).argmax()
    return np.array([*np.sort(np.delete(size, upright)), size[upright]])


@pytest.mark.parametrize("name", ["carton", "carton behind something", "carton on another"])
def test_all_sides_of_a_carton_are_known(name: str) -> None:
    edges = boxed(name)
    assert edges is not None
    true = np.array(SCENES[name][0].size)
    np.testing.assert_allclose(sides(edges.cuboid), true, atol=0.003)


@pytest.mark.parametrize("name", ["can", "ball"])
def test_round_things_are_no_cuboids(name: str) -> None:
    assert boxed(name) is None


def test_ends_out_of_sight_stay_open() -> None:
    edges = boxed("wall")
    assert edges is not None
    cuboid = edges.cuboid
    along = int(np.abs(cuboid.axes[:, 1]).argmax())  # it goes on to the left and the right
    np.testing.assert_array_equal(cuboid.open, np.arange(3) == np.full((2, 1), along))
    sides = np.sort(np.delete(cuboid.high - cuboid.low, along))
    np.testing.assert_allclose(sides, [0.06, 0.30], atol=0.004)
    middle = (cuboid.low + cuboid.high) / 2
    step = 1.0 * (np.arange(3) == along)
    beside = 1.0 * (np.arange(3) == (along + 1) % 3)
    places = np.stack([middle, middle + step, middle + step + beside]) @ cuboid.axes
    inside, beyond, outside = edges.depth_known(places.astype(np.float32))
    assert inside > 0.02
    assert np.isnan(beyond)
    assert outside < -0.1


@pytest.mark.parametrize("lies", [False, True])
def test_noise_makes_no_cuboid_of_a_can(lies: bool) -> None:
    can = Shape("lying cylinder", (0.035, 0.11), (0.0, 0.0, 0.035), 0.3) if lies else SCENES["can"][0]
    scene = FittedScene.of(make_tabletop((can,), noise=0.002).frame, PipelineConfig())
    assert isinstance(scene.shapes[0], RevolvedEdges)


@pytest.mark.parametrize("count", [0, 1, 60])
def test_few_points_are_of_no_shape(count: int) -> None:
    edges = boxed("carton")
    assert edges is not None
    points = observe(make_tabletop((CARTON,)).frame).objects[0].points
    few = points[:: len(points) // 60][:count]
    assert whole_shape(edges.edges, few, FusionConfig(), lambda places: np.zeros(len(places), bool)) is None


def test_two_faces_in_steps_are_no_cuboid() -> None:
    stairs = (CARTON, Shape("box", (0.06, 0.10, 0.06), (-0.055, -0.023, 0.03), 0.4))
    frame = make_tabletop(stairs).frame
    assert frame.labels is not None
    one = replace(frame, labels=np.minimum(frame.labels, 1))
    assert FittedScene.of(one, PipelineConfig()).shapes == [None]


def test_what_was_measured_is_read_as_it_was_and_the_rest_as_the_cuboid() -> None:
    edges = boxed("carton")
    assert edges is not None
    observation = observe(make_tabletop((CARTON,)).frame)
    points = observation.objects[0].points.astype(np.float32)
    measured, said = edges.edges.read(points), edges.read(points)
    np.testing.assert_array_equal(measured.distance, said.distance)
    np.testing.assert_array_equal(measured.depth, said.depth)
    behind = edges.edges.behind(points, 0.1)
    behind = behind[edges.edges.read(behind).distance > 0.01]  # to the image it is hidden
    beyond = edges.cuboid.depth(behind) < -0.01
    assert np.count_nonzero(beyond) > 100
    assert (edges.read(behind).distance[beyond] < 0).all()
    inner = edges.cuboid.inner(0.005)
    assert (edges.read(inner).depth == 0).all()


def test_depth_is_the_distance_to_the_faces() -> None:
    cuboid = Cuboid(np.eye(3), np.zeros(3), np.array([0.1, 0.2, 0.3]))
    points = np.float32([[0.05, 0.1, 0.15], [0.02, 0.1, 0.15], [0.13, 0.24, 0.1], [0.05, 0.1, 0.35]])
    np.testing.assert_allclose(cuboid.depth(points), [0.05, 0.02, -0.05, -0.05], atol=1e-6)


def test_bodies_move_guesses_within_and_beyond_them() -> None:
    guess = np.tile(np.float32([0.5, 0.3, 0.2]), (4, 1))
    depth = np.array([0.01, -0.01, np.nan, 0.002])

    class Known:
        never_hollow: ClassVar[bool] = True

        def depth_known(self, points: np.ndarray) -> np.ndarray:
            return depth

    told, filled = with_bodies(guess, np.zeros((4, 3), np.float32), [Known(), None])
    np.testing.assert_array_equal(filled, [True, False, False, True])
    np.testing.assert_allclose(told.sum(1), 1, rtol=1e-6)
    assert told[0, 1] > SURE
    np.testing.assert_allclose(told[1], [0.5 + 0.3 * SURE, 0.3 * (1 - SURE), 0.2], rtol=1e-6)
    np.testing.assert_array_equal(told[2], guess[2])  # it says nothing there
    assert guess[3, 1] < told[3, 1] < told[0, 1]  # near its surface it is less sure
    np.testing.assert_array_equal(guess, np.tile(np.float32([0.5, 0.3, 0.2]), (4, 1)))


def test_the_hidden_sides_of_a_carton_become_flat() -> None:
    table = make_tabletop((CARTON,))
    off = {}
    for cuboids in (False, True):
        config = PipelineConfig(mesh=MeshConfig(fusion=FusionConfig(cuboids=cuboids)))
        mesh = reconstruct(table.frame, config).objects[0].mesh
        assert mesh.is_watertight
        at = np.asarray(mesh.vertices)
        turn = np.array([[np.cos(0.4), np.sin(0.4), 0], [-np.sin(0.4), np.cos(0.4), 0], [0, 0, 1]])
        local = np.abs(at @ turn.T - [0, 0, 0.06]) - SIZE / 2
        off[cuboids] = np.quantile(np.abs(local.max(1)), 0.95)
    assert off[True] < 0.003
    assert off[True] < off[False]
