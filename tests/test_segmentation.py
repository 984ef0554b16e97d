"""The fallback segmentation: objects apart from each other, the table and the background."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from conftest import OBJECTS, Shape, make_tabletop

from mapping import FrameError
from perception import Observation, load_images, observe

REAL = Path("../shared/data/real_rgbd")


def assert_one_to_one(result: Observation, true: np.ndarray, count: int) -> None:
    """Each true object has exactly one segment, and they overlap well."""
    assert len(result.objects) == count
    taken = set()
    for label in range(1, count + 1):
        own = result.labels[true == label]
        segment = int(np.bincount(own[own > 0]).argmax())
        assert segment not in taken
        taken.add(segment)
        mine = result.labels == segment
        assert (mine & (true == label)).sum() / (mine | (true == label)).sum() > 0.6


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("eye", [(-0.55, 0.0, 0.50), (-0.45, 0.3, 0.60), (0.0, 0.0, 0.90)])
def test_separate_objects(eye: tuple[float, float, float], seed: int) -> None:
    scene = make_tabletop(eye=eye, noise=0.0015, seed=seed)
    result = observe(dataclasses.replace(scene.frame, labels=None))
    assert_one_to_one(result, scene.true_labels, len(OBJECTS))


@pytest.mark.parametrize(
    "pair",
    [
        (Shape("sphere", (0.05,), (0.0, -0.05, 0.05)), Shape("sphere", (0.05,), (0.0, 0.05, 0.05))),
        (Shape("cylinder", (0.04, 0.10), (0.0, -0.04, 0.05)), Shape("sphere", (0.05,), (0.0, 0.05, 0.05))),
        (
            Shape("box", (0.08, 0.08, 0.06), (0.0, -0.06, 0.03), 0.785),
            Shape("sphere", (0.05,), (0.0, 0.05, 0.05)),
        ),
    ],
)
def test_touching_round_objects_are_parted(pair: tuple[Shape, Shape]) -> None:
    scene = make_tabletop(pair, noise=0.0015, size=(640, 480))
    result = observe(dataclasses.replace(scene.frame, labels=None))
    assert_one_to_one(result, scene.true_labels, 2)


@pytest.mark.parametrize(
    "shape",
    [
        Shape("box", (0.06, 0.16, 0.20), (0.0, 0.0, 0.10), 0.6),
        Shape("cylinder", (0.02, 0.25), (0.0, 0.0, 0.125)),
        Shape("box", (0.025, 0.20, 0.02), (0.0, 0.0, 0.01), 0.3),
    ],
)
def test_one_object_stays_one(shape: Shape) -> None:
    scene = make_tabletop((shape,), noise=0.0015, size=(640, 480))
    result = observe(dataclasses.replace(scene.frame, labels=None))
    assert_one_to_one(result, scene.true_labels, 1)


def test_walls_and_floors_are_no_objects() -> None:
    background = (
        Shape("box", (0.02, 3.0, 2.0), (0.6, 0.0, 0.3)),
        Shape("box", (6.0, 6.0, 0.02), (0.0, 0.0, -0.75)),
    )
    scene = make_tabletop(background=background, table=(0.6, 0.6), noise=0.0015)
    result = observe(dataclasses.replace(scene.frame, labels=None))
    assert_one_to_one(result, scene.true_labels, len(OBJECTS))


def test_an_empty_table_is_an_error() -> None:
    scene = make_tabletop((), noise=0.0015)
    with pytest.raises(FrameError, match="no object"):
        observe(scene.frame)


@pytest.mark.skipif(not REAL.is_dir(), reason="no real frames (../shared/data/real_rgbd)")
def test_real_cluttered_frame_without_labels() -> None:
    folder = REAL / "graspnet_example"
    K = np.array(json.loads((REAL / "SOURCES.json").read_text())["graspnet_example"]["K"])
    result = observe(load_images(folder / "color.png", folder / "depth.png", None, K, 0.001))
    assert result.support is not None
    # Nine objects, of which two groups touch; a box and a robot arm stand beside the cloth.
    assert 6 <= len(result.objects) <= 12
