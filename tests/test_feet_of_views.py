"""Feet that no view sees: what a thing among others stands on is decided once for all views."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import Shape, make_tabletop

from perception.observation import Observation, ObservedObject
from reconstruction.config import PipelineConfig, TabletopSamples
from reconstruction.fitted_scene import FittedScene
from reconstruction.samples import reach_down
from reconstruction.samples.structure import structure

HIDDEN = Shape("cylinder", (0.03, 0.12), (0.0, 0.0, 0.06))
AROUND = tuple(
    Shape("box", (0.03, 0.16, 0.09), (0.075 * np.cos(turn), 0.075 * np.sin(turn), 0.045), turn)
    for turn in (0, np.pi / 2, np.pi, -np.pi / 2)
)
"""Boxes that hide all of it but its top."""
EYES = ((-0.55, 0.0, 0.3), (0.5, 0.2, 0.3), (0.0, 0.55, 0.3))
BED = 0.05


@pytest.fixture(scope="module")
def scene() -> FittedScene:
    frames = [
        make_tabletop((HIDDEN, *AROUND), eye=eye, size=(160, 120), noise=0.001, seed=seed).frame
        for seed, eye in enumerate(EYES)
    ]
    return FittedScene.of(frames[0], PipelineConfig(), 0, frames[1:])


def share_at(scene: FittedScene, height: float) -> float:
    """What the hidden thing's share of its middle is at some heights up to one [m], at least."""
    points = np.array([[0, 0, z] for z in np.linspace(0.003, height, 8)], np.float32)
    T_world_table = scene.shown.camera.T_world_camera @ np.linalg.inv(scene.observation.T_table_camera)
    local = (points - T_world_table[:3, 3].astype(np.float32)) @ T_world_table[:3, :3].astype(np.float32)
    column = 1 + [item.label for item in scene.observation.objects].index(1)
    none = np.empty((0, 3), np.float32)
    guess, _ = structure(scene.observation, scene.space, TabletopSamples(), local, none)
    return float(guess[:, column].min())


def beds(monkeypatch: pytest.MonkeyPatch, seeing: int) -> None:
    """So many of the views take the hidden thing to lie on something else."""
    seen: list[int] = []

    def bed_height(observation: Observation, item: ObservedObject) -> float | None:
        seen.append(item.label)
        return BED if seen.count(item.label) <= seeing else None

    monkeypatch.setattr(reach_down, "bed_height", bed_height)


def test_what_hides_its_foot_from_all_views_stands_on_the_table(scene: FittedScene) -> None:
    assert share_at(scene, 0.06) > 0.5


def test_a_thing_lies_on_what_all_views_see_it_lie_on(
    scene: FittedScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    beds(monkeypatch, seeing=2)
    assert share_at(scene, 0.06) > 0.5
    beds(monkeypatch, seeing=3)
    assert share_at(scene, BED) < 0.5
