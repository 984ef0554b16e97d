"""Fairing: teeth go, what was measured stays, and so does the volume."""

from __future__ import annotations

import cv2
import numpy as np
import trimesh
from conftest import OBJECTS, Shape, make_tabletop

from perception.observing import observe
from reconstruction.config import preset
from reconstruction.fitted_scene import FittedScene
from reconstruction.surface.faired import faired
from reconstruction.surface.measured_vertices import free_to_move
from reconstruction.surface.seen_surface import SeenSurface
from tools.evaluation.surface_card import creases_per_m

RADIUS, TEETH = 0.05, 0.0012


def rough_ball() -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
    """A ball of edges of 1.6 mm, and the same with teeth on it."""
    ball = trimesh.creation.icosphere(5, RADIUS)
    out = np.random.default_rng(0).choice([-TEETH, TEETH], len(ball.vertices))
    rough = trimesh.Trimesh(ball.vertices * (1 + out / RADIUS)[:, None], ball.faces, process=False)
    return ball, rough


def test_teeth_go_and_the_volume_stays() -> None:
    ball, rough = rough_ball()
    moved = faired(rough.vertices, rough.faces, np.ones(len(rough.vertices)), 4, 0.0025)
    smooth = trimesh.Trimesh(moved, rough.faces, process=False)
    assert creases_per_m(rough) > 100
    assert creases_per_m(smooth) < 1
    assert abs(smooth.volume / ball.volume - 1) < 0.01
    assert np.abs(np.linalg.norm(moved, axis=1) - RADIUS).mean() < 0.5 * TEETH


def test_no_vertex_moves_farther_than_it_may() -> None:
    _, rough = rough_ball()
    free = (rough.vertices[:, 2] > 0).astype(float)
    start = rough.vertices.astype(np.float32)
    moved = faired(start, rough.faces, free, 4, 0.0005)
    off = np.linalg.norm(moved - start, axis=1)
    np.testing.assert_array_equal(moved[free == 0], start[free == 0])
    assert 0.0004 < off.max() < 0.000501


def test_what_was_measured_is_held_but_for_its_outline() -> None:
    observation = observe(make_tabletop((Shape("sphere", (0.05,), (0.0, 0.0, 0.05)),)).frame)
    edges, item = SeenSurface.of(observation).edges(0), observation.objects[0]
    mask = np.zeros(observation.depth.size, np.uint8)
    mask[item.pixels] = 1
    inwards = cv2.distanceTransform(mask.reshape(observation.depth.shape), cv2.DIST_L2, 5).reshape(-1)[
        item.pixels
    ]
    free = free_to_move(edges, item.points)
    assert free[inwards > 4].max() < 0.2
    assert free[inwards < 2].mean() > 0.8
    assert (free_to_move(edges, edges.behind(item.points[inwards > 4], 0.03)) == 1).all()


def test_meshes_are_smoother_and_no_less_right() -> None:
    frame = make_tabletop(OBJECTS, size=(240, 180), noise=0.002).frame
    found = {}
    for rounds in (0, 4):
        scene = FittedScene.of(frame, preset("tabletop", mesh={"fusion": {"fair": rounds}}))
        found[rounds] = [surface.mesh for surface in scene.meshes if surface is not None]
    assert len(found[0]) == len(found[4]) == len(OBJECTS)
    for rough, smooth in zip(found[0], found[4]):
        assert smooth.is_watertight
        assert abs(smooth.volume / rough.volume - 1) < 0.02
        np.testing.assert_array_equal(smooth.faces, rough.faces)
    assert sum(map(creases_per_m, found[4])) < 0.6 * sum(map(creases_per_m, found[0]))
