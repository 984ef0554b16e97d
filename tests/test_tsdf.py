"""The TSDF baseline: it is right where the camera saw, and knows what it did not see."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import Shape, make_tabletop

from perception.frame import Frame
from perception.observation import Observation
from perception.observing import observe
from perception.space import Region, Space
from tools.evaluation.fitted_map import View
from tools.evaluation.tsdf import TRUNCATION, VOXEL, FittedTsdf

BALL = 0.05


@pytest.fixture(scope="module")
def frame() -> Frame:
    ball = Shape("sphere", (BALL,), (0.0, 0.05, BALL))
    box = Shape("box", (0.08, 0.08, 0.06), (0.0, -0.12, 0.03))
    return make_tabletop((ball, box), size=(320, 240)).frame


@pytest.fixture(scope="module")
def observation(frame: Frame) -> Observation:
    return observe(frame)


@pytest.fixture(scope="module")
def fitted(frame: Frame, observation: Observation) -> FittedTsdf:
    return FittedTsdf(View(frame, observation, Space.of(observation)))


def test_the_surface_lies_where_it_was_seen(observation: Observation, fitted: FittedTsdf) -> None:
    eye = Space.of(observation).origin
    for index, item in enumerate(observation.objects):
        rays = item.points - eye
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        behind = fitted.predict((item.points + 0.007 * rays).astype(np.float32))[0][:, index + 1]
        before = fitted.predict((item.points - 0.012 * rays).astype(np.float32))[0][:, index + 1]
        assert (behind > 0.5).mean() > 0.9
        assert (before < 0.5).mean() > 0.97


def test_distances_are_in_metres(observation: Observation, fitted: FittedTsdf) -> None:
    # Along the ray through the ball's nearest point the distance is exact.
    points = observation.objects[0].points
    eye = Space.of(observation).origin
    nearest = points[np.argmin(np.linalg.norm(points - eye, axis=1))]
    ray = (nearest - eye) / np.linalg.norm(nearest - eye)
    distance, known = fitted.volumes[0].at(
        (nearest + np.array([[-0.01], [0.0], [0.01]]) * ray).astype(np.float32)
    )
    assert known.all()
    np.testing.assert_allclose(distance * TRUNCATION * VOXEL, [0.01, 0, -0.01], atol=0.003)


def test_hidden_space_is_uncertain_and_free_space_is_not(
    observation: Observation, fitted: FittedTsdf
) -> None:
    space = Space.of(observation)
    low, high = (np.array([b[i] for b in (o.bounds for o in observation.objects)]) for i in (0, 1))
    points = np.random.default_rng(0).uniform(low.min(0) - 0.05, high.max(0) + 0.05, (20_000, 3))
    points = points[points[:, 2] > 0.005].astype(np.float32)
    _, uncertainty = fitted.predict(points)
    region = space.classify(points)
    deep = (region == Region.OCCLUDED) & (space.depth_behind(points) > 0.03)
    assert uncertainty[deep].mean() > 0.9
    assert uncertainty[region == Region.FREE].mean() < 0.2


def test_probabilities_sum_to_one(observation: Observation, fitted: FittedTsdf) -> None:
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (1000, 3)).astype(np.float32)
    probability, uncertainty = fitted.predict(points)
    np.testing.assert_allclose(probability.sum(1), 1, atol=1e-6)
    assert probability.min() >= 0
    assert ((uncertainty >= 0) & (uncertainty <= 1)).all()
