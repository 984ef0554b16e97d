"""What is worked out of each of several views once is what would be worked out of all of them at once."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from conftest import make_tabletop
from test_views import EYES, views

from mapping.hinges import lattice_near_points
from mapping.known_points import first_in_cells
from perception.views.joint import JointObservation
from perception.views.joint_space import space_of
from perception.views.observing_together import observe_together
from reconstruction.config import TabletopSamples
from reconstruction.samples.scope import Scope


@pytest.fixture(scope="module")
def joint() -> JointObservation:
    """Three views, the last of another size."""
    frames = [*views(2), make_tabletop(eye=EYES[2], size=(128, 96)).frame]
    return observe_together(frames, ordered=True)


def test_images_are_put_together_when_they_are_asked_for(joint: JointObservation) -> None:
    fresh = pickle.loads(pickle.dumps(joint))
    assert "labels" not in fresh.__dict__
    np.testing.assert_array_equal(fresh.labels, joint.labels)
    assert fresh.labels is fresh.labels
    for number, view in enumerate(joint.views):
        height, width = view.observation.depth.shape
        part = slice(joint.stack.rows[number], joint.stack.rows[number] + height)
        np.testing.assert_array_equal(joint.depth[part, :width], view.observation.depth)
        np.testing.assert_array_equal(joint.labels[part, :width], view.observation.labels)
        assert joint.seen is not None
        np.testing.assert_array_equal(joint.seen[part, :width], view.observation.seen)
        pixels = np.arange(height * width)
        np.testing.assert_array_equal(joint.stack.taken(number, joint.stack.place(number, pixels)), pixels)
    with pytest.raises(AttributeError):
        joint.depths  # noqa: B018


def test_views_know_which_pixels_show_an_object(joint: JointObservation) -> None:
    pixels = np.arange(joint.depth.size)
    inside = (joint.stack.taken(2, pixels) % 128 < 128) & (pixels % joint.stack.width < 128)
    pixels = pixels[inside]
    want = joint.owner[pixels] < len(joint.objects)
    assert 0.01 < want.mean() < 0.9
    np.testing.assert_array_equal(joint.shows_object(pixels), want)


def test_points_are_thinned_view_by_view(joint: JointObservation) -> None:
    for item in joint.objects:
        for size in (0.002, 0.01):
            want = item.points[first_in_cells(item.points, size)]
            for _ in range(2):  # the second time it is known
                np.testing.assert_array_equal(joint.thinned(item.label, size), want)
            first = [own for own in joint.views[0].observation.objects if own.label == item.label]
            for own in first:
                alone = joint.thinned(item.label, size, joint.views[:1])
                np.testing.assert_array_equal(alone, own.points[first_in_cells(own.points, size)])


def test_cells_that_hold_seen_points_are_known_view_by_view(joint: JointObservation) -> None:
    config = TabletopSamples()
    scopes = Scope.all_of(joint, space_of(joint), config, np.random.default_rng(0))
    for scope in scopes:
        for spacing, distance in ((0.0125, 0.02), (0.006, 0.0)):
            want = lattice_near_points(scope.seen, distance, spacing)
            for _ in range(2):
                nodes = scope.seen_nodes(spacing)
                assert len(nodes) < 0.9 * len(scope.seen)
                np.testing.assert_array_equal(lattice_near_points(nodes, distance, spacing), want)
