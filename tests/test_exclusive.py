"""No place is two objects': lattices lowered, and the meshes of whole scenes."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from conftest import Shape, make_tabletop

from reconstruction import reconstruct
from reconstruction.config import PipelineConfig
from reconstruction.fitted_scene import FittedScene
from reconstruction.solid import Solid
from reconstruction.surface.exclusive import exclusive
from reconstruction.surface.meshing import mesh_of, object_solid

NODES = np.stack(np.meshgrid(*[np.arange(24.0)] * 3, indexing="ij"), -1)
LEANING = (
    Shape("lying cylinder", (0.03, 0.12), (0, 0, 0.03), 0.5),
    Shape("sphere", (0.035,), (0.05, 0.03, 0.035)),
    Shape("box", (0.04, 0.05, 0.12), (0.05, -0.06, 0.06)),
)
"""The box's hidden depth is unknown; the ball's hidden side follows from the one in view."""


def ball(centre: tuple[float, float, float], radius: float) -> np.ndarray:
    """How deep each of 24^3 nodes lies in a ball [nodes]."""
    return (radius - np.linalg.norm(NODES - centre, axis=-1)).astype(np.float32)


def overlap_mm(one, other) -> float:
    """How deep a corner or the middle of a triangle of either mesh lies in the other [mm]."""
    deepest = 0.0
    for mesh, within in ((one, other), (other, one)):
        points = np.concatenate([mesh.vertices, mesh.triangles_center]).astype(np.float32)
        solid = Solid(within)
        inside = points[solid.inside(points)]
        deepest = max(deepest, *solid.distance(inside).tolist(), 0.0)
    return 1e3 * deepest


def test_the_border_is_where_both_claims_are_equal() -> None:
    a, b = ball((8, 12, 12), 6), ball((16, 12, 12), 6)
    zero = np.zeros(3, int)
    one, other = exclusive([a, b], [zero, zero], [0, 0])
    assert np.count_nonzero((a > 0) & (b > 0)) > 50
    assert (one + other <= 1e-6).all()
    nearer = np.abs(NODES[..., 0] - 8) < np.abs(NODES[..., 0] - 16)
    assert ((one > 0) == (a > 0) & (nearer | (b < 0) | (NODES[..., 0] == 12))).all()
    assert ((one > 0) | (other > 0) == (a > 0) | (b > 0)).all()  # nothing is lost to both


def test_an_object_yields_to_those_of_a_higher_rank() -> None:
    a, b = ball((8, 12, 12), 6), ball((16, 12, 12), 6)
    zero = np.zeros(3, int)
    for ranks in ((1, 0), (0, 1), (1, 2)):
        found = exclusive([a, b], [zero, zero], ranks)
        sure, unsure = (0, 1) if ranks[0] > ranks[1] else (1, 0)
        np.testing.assert_allclose(found[sure], (a, b)[sure], atol=0.0101)
        assert (found[unsure] <= np.maximum(-found[sure], (a, b)[unsure])).all()
        assert (found[unsure][found[sure] > 0] < 0).all()


def test_lattices_lie_where_their_first_nodes_are() -> None:
    whole = ball((12, 12, 12), 6)
    first = np.array([5, 6, 7])
    part = ball((16, 12, 12), 6)[5:, 6:, 7:].copy()
    one, other = exclusive([whole, part], [np.zeros(3, int), first], [0, 0])
    assert (one[5:, 6:, 7:] + other <= 1e-6).all()
    assert np.count_nonzero(other > 0) < np.count_nonzero(part > 0)


def test_objects_apart_are_left_as_they_are() -> None:
    a, b = ball((5, 12, 12), 4), ball((18, 12, 12), 4)
    zero = np.zeros(3, int)
    one, other = exclusive([a, b], [zero, zero], [0, 0])
    assert one is a
    assert other is b
    far = np.array([100, 0, 0])
    assert exclusive([a, a], [zero, far], [1, 0])[1] is a


def test_of_three_no_two_keep_one_place() -> None:
    claims = [ball((9, 12, 12), 6), ball((15, 12, 12), 6), ball((12, 16, 12), 6)]
    found = exclusive(claims, [np.zeros(3, int)] * 3, [0, 2, 1])
    for one, other in combinations(found, 2):
        assert (one + other <= 1e-6).all()


@pytest.fixture(scope="module")
def scene() -> FittedScene:
    return FittedScene.of(make_tabletop(LEANING, size=(240, 180), noise=0.001).frame, PipelineConfig())


def test_meshes_of_neighbours_do_not_overlap(scene) -> None:
    meshes = [surface.mesh for surface in scene.meshes]
    pairs = list(combinations(range(len(meshes)), 2))
    assert max(overlap_mm(meshes[a], meshes[b]) for a, b in pairs) < 0.6
    for mesh in meshes:
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.volume > 0
    # They would, each taken by itself.
    alone = []
    for index in range(len(meshes)):
        points = scene.observation.objects[index].points
        own = object_solid(scene.field, index, scene.config.mesh, points, scene.seen, scene.shapes[index])
        alone.append(mesh_of(own, scene.field, index, scene.config.mesh)[0])
    assert max(overlap_mm(alone[a], alone[b]) for a, b in pairs) > 5


def test_one_thread_and_two_give_neighbours_the_same_meshes(scene) -> None:
    import torch

    before = torch.get_num_threads()
    try:
        torch.set_num_threads(1 if before > 1 else 2)
        again = reconstruct(scene.frame)
    finally:
        torch.set_num_threads(before)
    for surface, item in zip(scene.meshes, again.objects):
        assert (surface.mesh.faces == item.mesh.faces).all()
        assert (surface.uncertainty == item.uncertainty).all()
