"""Bodies of revolution: which things are taken for one, and how well the hidden half is known."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from conftest import Shape, make_tabletop
from scipy.spatial import cKDTree

from perception.observing import observe
from reconstruction.config import FusionConfig
from reconstruction.surface.handle_width import handle_width
from reconstruction.surface.revolved import HANDLE, RevolvedEdges
from reconstruction.surface.seen_surface import Edges, SeenSurface
from reconstruction.surface.slanted_axis import slanted_axis
from reconstruction.surface.unseen_cavity import DEEP
from reconstruction.surface.vertical_axis import vertical_axis
from reconstruction.surface.whole_shape import whole_shape

CAN = Shape("cylinder", (0.04, 0.12), (0.03, 0.02, 0.06))
LYING = Shape("lying cylinder", (0.035, 0.11), (0.0, 0.0, 0.035), 0.5)
SOLIDS = {
    "can": CAN,
    "lying can": LYING,
    "drum": Shape("cylinder", (0.12, 0.10), (0.10, 0.0, 0.05)),
    "ball": Shape("sphere", (0.04,), (0.0, 0.03, 0.04)),
    "carton": Shape("box", (0.06, 0.10, 0.12), (0.0, 0.0, 0.06), 0.3),
    "carton from its corner": Shape("box", (0.08, 0.08, 0.12), (0.0, 0.0, 0.06), 0.8),
}
AXIS = np.array([0.3, -0.2])


def wall(
    angles: np.ndarray, radius: float, inside: bool, noise: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals into the solid of an upright tube's wall."""
    rng = np.random.default_rng(0)
    outward = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], 1)
    points = outward * (radius + noise * rng.normal(size=len(angles)))[:, None]
    points[:, :2] += AXIS
    points[:, 2] = rng.uniform(0, 0.1, len(angles))
    tilt = noise * 50 * rng.normal(size=(len(angles), 3))
    normals = (outward if inside else -outward) + tilt
    return points.astype(np.float32), (normals / np.linalg.norm(normals, axis=1)[:, None]).astype(np.float32)


def test_the_axis_of_half_a_tube_is_found_beside_a_handle() -> None:
    rng = np.random.default_rng(1)
    points, normals = wall(rng.uniform(-1.2, 1.2, 600), 0.04, inside=False, noise=0.001)
    handle = np.array([AXIS[0] + 0.06, AXIS[1], 0.05]) + rng.uniform(-0.01, 0.01, (60, 3))
    sideways = np.tile([0.0, 1.0, 0.0], (60, 1))
    axis = vertical_axis(
        np.concatenate([points, handle.astype(np.float32)]),
        np.concatenate([normals, sideways.astype(np.float32)]),
    )
    assert axis is not None
    assert np.abs(axis - AXIS).max() < 0.002


def test_inner_and_outer_walls_share_the_axis() -> None:
    rng = np.random.default_rng(2)
    outer = wall(rng.uniform(-0.8, 0.8, 400), 0.04, inside=False, noise=0.0005)
    inner = wall(rng.uniform(2.3, 4.0, 400), 0.036, inside=True, noise=0.0005)
    axis = vertical_axis(*(np.concatenate(pair) for pair in zip(outer, inner)))
    assert axis is not None
    assert np.abs(axis - AXIS).max() < 0.001


@pytest.mark.parametrize("slope", [0.0, 0.4])
def test_the_axis_of_a_lying_tube_or_cone_is_found(slope: float) -> None:
    rng = np.random.default_rng(4)
    angle, along = rng.uniform(-1.3, 1.3, 800), rng.uniform(0, 0.12, 800)
    radius = 0.03 + slope * along + 0.0005 * rng.normal(size=800)
    outward = np.stack([np.cos(angle), np.sin(angle), np.full(800, -slope)], 1)
    upright = np.stack([radius * np.cos(angle), radius * np.sin(angle), along], 1)
    direction = np.array([0.8, -0.5, 0.33])
    direction /= np.linalg.norm(direction)
    aside = np.cross(direction, [0.0, 0.0, 1.0])
    aside /= np.linalg.norm(aside)
    turn = np.stack([aside, np.cross(direction, aside), direction])
    start = np.array([0.2, 0.3, 0.05])
    points, normals = upright @ turn + start, -outward @ turn / np.hypot(1, slope)
    handle = start + rng.uniform(0.05, 0.07, (60, 3))
    found = slanted_axis(
        np.concatenate([points, handle]).astype(np.float32),
        np.concatenate([normals, np.tile([1.0, 0, 0], (60, 1))]).astype(np.float32),
    )
    assert found is not None
    turned, axis = found
    assert abs(turned[2] @ direction) > np.cos(np.deg2rad(1.5))
    middle = turned @ (start + 0.06 * direction)
    np.testing.assert_allclose(axis, middle[:2], atol=0.001)


def test_flat_and_few_points_have_no_axis() -> None:
    rng = np.random.default_rng(3)
    flat = np.stack([np.zeros(500), rng.uniform(-0.05, 0.05, 500), rng.uniform(0, 0.1, 500)], 1)
    faces = np.tile(np.float32([1, 0, 0]), (500, 1))
    assert vertical_axis(flat.astype(np.float32), faces) is None
    assert vertical_axis(*wall(np.linspace(-1, 1, 50), 0.04, inside=False)) is None
    level = np.tile(np.float32([0, 0, -1]), (500, 1))  # a table top
    assert vertical_axis(flat.astype(np.float32), level) is None


def round_body(edges: Edges, points: np.ndarray) -> RevolvedEdges | None:
    shape = whole_shape(edges, points, FusionConfig(), lambda places: np.zeros(len(places), bool))
    return shape if isinstance(shape, RevolvedEdges) else None


@cache
def revolved(name: str) -> RevolvedEdges | None:
    observation = observe(make_tabletop((SOLIDS[name],)).frame)
    edges = SeenSurface.of(observation, floors=[-0.0015]).edges(0)
    return round_body(edges, observation.objects[0].points)


@pytest.mark.parametrize("name", SOLIDS)
def test_round_things_are_told_from_cartons(name: str) -> None:
    assert (revolved(name) is not None) == (name in ("can", "lying can", "drum", "ball"))


@pytest.mark.parametrize("width", [0.006, 0.012, None])
def test_a_handle_is_about_as_thick_as_it_is_wide(width: float | None) -> None:
    # A strap that stands beside the can, turned to the camera.
    strap = Shape("box", (width or 0.01, width or 0.01, 0.09), (0.03, 0.085, 0.05))
    frame = make_tabletop((CAN, strap), size=(640, 480)).frame
    assert frame.labels is not None
    kept = np.where(frame.labels == 2, 1 if width else 0, frame.labels).astype(frame.labels.dtype)
    observation = observe(replace(frame, labels=kept))
    edges = SeenSurface.of(observation, floors=[-0.0015]).edges(0)
    shape = round_body(edges, observation.objects[0].points)
    assert shape is not None
    found = handle_width(edges, shape.body)
    if width is None:
        assert found == 0
    else:
        assert found == pytest.approx(width, rel=0.35)
        assert shape.handle == np.clip(found, *HANDLE)


def ring(edges: RevolvedEdges, radius: float, angle: np.ndarray) -> np.ndarray:
    x, y = edges.body.axis[:, None] + radius * np.stack([np.cos(angle), np.sin(angle)])
    return np.stack([x, y, np.full_like(x, 0.06)], 1).astype(np.float32)


def test_the_hidden_side_of_a_can_lies_where_its_circle_does() -> None:
    edges = revolved("can")
    assert edges is not None
    angle = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    for offset in (-0.003, -0.0015, 0.002):
        depth = edges.body.depth(ring(edges, 0.04 + offset, angle))
        np.testing.assert_allclose(depth, -offset, atol=0.001)
    assert (edges.body.depth(ring(edges, 0.052, angle)) < 0).all()
    assert edges.full  # nothing of an inner wall is seen
    assert edges.body.depth(np.float32([[*edges.body.axis, 0.06]]))[0] == DEEP


def test_the_underside_of_a_lying_can_is_known() -> None:
    edges = revolved("lying can")
    assert edges is not None
    assert abs(edges.body.turn[2] @ [np.cos(0.5), np.sin(0.5), 0]) > np.cos(np.deg2rad(3))
    angle, along = np.meshgrid(np.linspace(0, 2 * np.pi, 60, endpoint=False), np.linspace(-0.04, 0.04, 9))
    local = np.stack([along, 0.035 * np.cos(angle), 0.035 * np.sin(angle)], -1).reshape(-1, 3)
    turn = np.array([[np.cos(0.5), -np.sin(0.5), 0], [np.sin(0.5), np.cos(0.5), 0], [0, 0, 1]])
    table = make_tabletop((LYING,))
    T = observe(table.frame).T_table_camera @ np.linalg.inv(table.frame.camera.T_world_camera)
    points = ((local @ turn.T + LYING.position) @ T[:3, :3].T + T[:3, 3]).astype(np.float32)
    assert np.quantile(np.abs(edges.body.depth(points)), 0.9) < 0.002
    known = edges.depth_known(points + np.float32([0, 0, -0.004]))
    assert (known[points[:, 2] < 0.005] < 0).all()  # under the can nothing is of it


def test_what_was_measured_is_read_as_it_was() -> None:
    edges = revolved("can")
    assert edges is not None
    observation = observe(make_tabletop((CAN,)).frame)
    points = observation.objects[0].points.astype(np.float32)
    measured, said = edges.edges.read(points), edges.read(points)
    np.testing.assert_array_equal(measured.distance, said.distance)
    np.testing.assert_array_equal(measured.depth, said.depth)


def test_a_hidden_side_rises_and_falls_with_the_distance_to_it() -> None:
    edges = revolved("can")
    assert edges is not None
    hidden = ring(edges, 0.04, np.linspace(0, 2 * np.pi, 720, endpoint=False))
    reading = edges.edges.read(hidden)
    hidden = hidden[(reading.distance > 0.01) & (reading.depth > 0.01)]
    assert len(hidden) > 100
    outward = (hidden[:, :2] - edges.body.axis) / 0.04
    for off in (-0.002, 0.001, 0.002):
        moved = hidden.copy()
        moved[:, :2] += np.float32(off) * outward
        reading = edges.read(moved)
        # The cap on log odds, and what they are raised to: both say the same.
        np.testing.assert_allclose(reading.distance, -off, atol=0.001)
        if off > 0:
            np.testing.assert_allclose(edges.wall - reading.depth, -off, atol=0.001)


def test_no_cell_of_a_wide_body_s_wall_is_left_out() -> None:
    edges = revolved("drum")
    assert edges is not None
    side = edges.circles[np.hypot(*(edges.circles[:, :2] - edges.body.axis).T) > 0.117]
    angle = np.linspace(0, 2 * np.pi, 500, endpoint=False)
    apart = cKDTree(side).query(ring(edges, 0.12, angle))[0]
    assert apart.max() < 0.0035  # within a cell of 5 mm, or the one beside it


def test_what_lies_close_behind_a_handle_stays() -> None:
    shape = Shape("box", (0.03, 0.02, 0.06), (0.03, 0.02 + 0.05, 0.06))
    frame = make_tabletop((CAN, shape)).frame
    assert frame.labels is not None
    handle = frame.labels == 2
    observation = observe(replace(frame, labels=np.minimum(frame.labels, 1)))
    edges = SeenSurface.of(observation, floors=[-0.0015]).edges(0)
    item = observation.objects[0]
    both = round_body(edges, item.points)
    assert both is not None
    of_handle = item.points[handle.reshape(-1)[item.pixels]].astype(np.float32)
    of_handle = of_handle[np.hypot(*(of_handle[:, :2] - both.body.axis).T) > 0.052]
    assert len(of_handle) > 50
    behind = edges.behind(of_handle, 0.008)
    assert (both.body.depth(behind) < 0).mean() > 0.5  # turned, it would be empty there
    np.testing.assert_array_equal(both.read(behind).distance, edges.read(behind).distance)
    np.testing.assert_array_equal(both.read(behind).depth, edges.read(behind).depth)
