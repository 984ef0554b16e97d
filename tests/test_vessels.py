"""Vessels are told from solids in any pose, and how much of their outside is seen."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from reconstruction.solid import Solid
from tools.evaluation.vessels import is_vessel, outside_seen

TURN = trimesh.transformations.rotation_matrix(0.9, [1, 0.4, 0.2])


def cup() -> trimesh.Trimesh:
    tube = trimesh.creation.annulus(0.037, 0.04, 0.1)
    floor = trimesh.creation.cylinder(0.0385, 0.003)
    floor.apply_translation([0, 0, -0.0485])
    return trimesh.boolean.union([tube, floor], engine="manifold")


@pytest.mark.parametrize("pose", [np.eye(4), TURN])
@pytest.mark.parametrize("name", ["cup", "tube", "can", "box"])
def test_a_cup_is_a_vessel_and_what_holds_nothing_is_not(name: str, pose: np.ndarray) -> None:
    mesh = {
        "cup": cup,
        "tube": lambda: trimesh.creation.annulus(0.037, 0.04, 0.1),
        "can": lambda: trimesh.creation.cylinder(0.04, 0.1),
        "box": lambda: trimesh.creation.box((0.05, 0.08, 0.1)),
    }[name]()
    mesh.apply_transform(pose)
    assert is_vessel(Solid(mesh)) == (name == "cup")


def test_half_a_cup_is_seen_from_one_side() -> None:
    mesh = cup()
    points = trimesh.sample.sample_surface(mesh, 20000, seed=1)[0]
    assert outside_seen(mesh, points) > 0.99
    assert 0.45 < outside_seen(mesh, points[points[:, 0] > 0]) < 0.6
    assert outside_seen(mesh, points[:1]) < 0.02
