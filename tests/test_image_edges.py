"""Edges of an object's image, and what is known of free space beside unmeasured pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import Shape, make_tabletop
from scipy import ndimage

from perception.observing import observe
from reconstruction.surface.image_edges import edge_pixels
from reconstruction.surface.seen_surface import SeenSurface

BALL = Shape("sphere", (0.04,), (0.0, 0.03, 0.04))


def test_unmeasured_pixels_end_free_space() -> None:
    frame = make_tabletop((BALL,)).frame
    own, depth = np.zeros((40, 40), bool), np.full((40, 40), 0.9, np.float32)
    own[15:25, 15:25] = True
    depth[own] = 0.6
    shadow = ndimage.binary_dilation(own, iterations=3) & ~own
    near, far = edge_pixels(own, depth, frame.camera)
    assert near[15, 20]
    assert far[14, 20]
    depth[shadow] = np.nan
    near, far = edge_pixels(own, depth, frame.camera)
    assert near[12, 20]  # the outermost of them
    assert not near[14, 20]  # beside what is unmeasured itself
    assert not near[15:25, 15:25].any()
    assert far[11, 20]  # what was measured beside it
    assert not far[shadow | own].any()


@pytest.mark.parametrize(("slope", "ripple"), [(0.0, 0.05), (0.3, 0.17), (1.0, 0.05)])
def test_a_straight_outline_has_no_scallops(slope: float, ripple: float) -> None:
    frame = make_tabletop((BALL,)).frame
    K, height, width = frame.camera.K, frame.camera.height, frame.camera.width
    v, u = np.indices((height, width))
    normal = np.array([1.0, slope]) / np.hypot(1.0, slope)

    def beyond(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return (u - 160.3) * normal[0] + (v - 120.0) * normal[1]

    owner = np.where(beyond(u, v) < 0, 0, -1).astype(np.int32)
    depth = np.where(owner == 0, 0.5, 0.8).astype(np.float32)
    planes = np.where((owner == 0).reshape(-1, 1), np.float32([0, 0, 1, 0.5]), np.float32(0))
    part = slice(60, 180), slice(100, 161 + int(60 * slope))
    seen = SeenSurface(frame.camera, np.eye(4), owner, depth, planes, 0.0, None, [part])
    along = np.linspace(-30, 30, 400)[:, None] * np.array([-normal[1], normal[0]]) + np.array([160.3, 120.0])
    for off in (-1.2, 0.8, 1.2):
        at = along + off * normal
        away = 0.55  # behind the near surface, before the far one
        points = away * np.column_stack([(at - K[:2, 2]) / K[0, 0], np.ones(len(at))])
        pixels = seen.edges(0).read(points.astype(np.float32)).distance * K[0, 0] / away
        assert (np.sign(pixels) == -np.sign(off)).all()
        assert abs(pixels.mean() + off) < 0.2
        assert pixels.std() < ripple


def test_an_outline_goes_straight_on_to_the_border_of_the_image() -> None:
    frame = make_tabletop((BALL,)).frame
    K, shape = frame.camera.K, (frame.camera.height, frame.camera.width)
    owner = np.where(np.indices(shape)[1] < 160, 0, -1).astype(np.int32)
    depth = np.where(owner == 0, 0.5, 0.8).astype(np.float32)
    planes = np.where((owner == 0).reshape(-1, 1), np.float32([0, 0, 1, 0.5]), np.float32(0))
    part = slice(0, shape[0]), slice(100, 160)
    seen = SeenSurface(frame.camera, np.eye(4), owner, depth, planes, 0.0, None, [part])
    at = np.array([[u, v] for u in (158.5, 160.5) for v in (-0.4, 20.0)])
    points = 0.55 * np.column_stack([(at - K[:2, 2]) / K[0, 0], np.ones(len(at))])
    found = seen.edges(0).read(points.astype(np.float32)).distance
    np.testing.assert_allclose(found[::2], found[1::2], atol=1e-5)


def test_free_space_is_as_far_as_the_nearest_unmeasured_pixel() -> None:
    frame = make_tabletop((BALL,)).frame
    assert frame.labels is not None
    shadow = ndimage.binary_dilation(frame.labels == 1, iterations=4) & (frame.labels != 1)
    depth = np.where(shadow, np.nan, frame.depth).astype(np.float32)
    observation = observe(replace(frame, depth=depth))
    seen = SeenSurface.of(observation)
    outside = ndimage.binary_dilation(shadow, iterations=1) & ~shadow & (frame.labels != 1)
    row, column = np.nonzero(outside & np.isfinite(depth))
    K, T = frame.camera.K, observation.T_table_camera
    away = float(np.median(frame.depth[frame.labels == 1]))  # beside the ball, before the table
    rays = np.stack([(column - K[0, 2]) / K[0, 0], (row - K[1, 2]) / K[1, 1], np.ones(len(row))], 1)
    points = ((away * rays) @ T[:3, :3].T + T[:3, 3]).astype(np.float32)
    free = seen.depth[row, column] - away > 0.02
    distance = seen.edges(0).read(points[free]).distance
    assert free.sum() > 30
    assert (distance < 0).all()
    pixel = away / K[0, 0]
    assert np.quantile(-distance, 0.9) < 1.5 * pixel
    # On its other side the object may be as far as free space is.
    row, column = np.nonzero(shadow & ndimage.binary_dilation(~shadow & (frame.labels != 1)))
    rays = np.stack([(column - K[0, 2]) / K[0, 0], (row - K[1, 2]) / K[1, 1], np.ones(len(row))], 1)
    points = ((away * rays) @ T[:3, :3].T + T[:3, 3]).astype(np.float32)
    distance = seen.edges(0).read(points[points[:, 2] > 0.02]).distance
    assert (distance > 0).all()
    assert np.quantile(distance, 0.9) < 1.5 * pixel
