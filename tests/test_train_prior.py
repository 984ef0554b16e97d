"""Training data and training of the occlusion prior, on a small scale."""

from __future__ import annotations

import json

import numpy as np
import pytest

from sim_scenes.training.scenes import inside, make_training_scene
from sim_scenes.training.shapes import (
    FAMILIES,
    HELD_OUT_FAMILIES,
    TRAINING_FAMILIES,
    TrainingShape,
    draw_shape,
)

pytest.importorskip("open3d")


@pytest.mark.parametrize("family", sorted(FAMILIES))
def test_parts_are_solid_and_of_household_size(family):
    rng = np.random.default_rng(3)
    for _ in range(3):
        shape = draw_shape(rng, (family,))
        assert all(part.is_watertight and part.volume > 0 for part in shape.parts)
        corners = np.concatenate([part.vertices for part in shape.parts])
        assert 0.01 < np.ptp(corners, axis=0).max() < 0.7


def test_held_out_families_are_not_trained_on():
    assert set(TRAINING_FAMILIES).isdisjoint(HELD_OUT_FAMILIES)
    rng = np.random.default_rng(0)
    assert {draw_shape(rng).family for _ in range(60)}.isdisjoint(HELD_OUT_FAMILIES)


def test_inside_is_the_union_of_parts():
    from sim_scenes.training.mesh_blocks import box, rounded

    shape = TrainingShape("pair", (box([2, 2, 2]), rounded([1, 1, 1], 1.0, [3, 0, 0])))
    points = np.array([[0.9, 0.9, 0.9], [3.0, 0, 0], [3.9, 0.9, 0], [1.5, 0, 0]], np.float32)
    assert inside(shape, points).tolist() == [True, True, False, False]


def test_scenes_rest_on_the_table_and_repeat():
    scenes = [make_training_scene(draw_shape, np.random.default_rng(4)) for _ in range(2)]
    for shape in scenes[0].shapes.values():
        assert min(part.bounds[0, 2] for part in shape.parts) > -1e-4
    np.testing.assert_array_equal(scenes[0].frame.depth, scenes[1].frame.depth)
    np.testing.assert_array_equal(scenes[0].frame.labels, scenes[1].frame.labels)


def test_examples_agree_with_the_shapes():
    from tools.prior_data import make_examples

    def ball(rng: np.random.Generator) -> TrainingShape:
        return draw_shape(rng, ("ball",))

    examples = make_examples(2, ball, 0)
    lattices, local, points, truth = examples.inputs(np.arange(len(examples)))
    assert len(lattices) == len(local) == len(points) == len(truth) == len(examples) > 0
    assert np.isfinite(lattices).all()
    assert np.isfinite(points).all()
    # A ball's inside lies near the visible surface and not in the far corners of its box.
    assert 0.02 < truth.mean() < 0.9
    corner = (np.abs(local) > 0.9).all(axis=-1)
    assert truth[corner].sum() == 0


def test_examples_do_not_depend_on_the_number_of_workers():
    from dataclasses import fields

    from tools.prior_data import Examples, make_examples

    alone, shared = (make_examples(3, draw_shape, 5, workers=workers) for workers in (1, 2))
    for field in fields(Examples):
        np.testing.assert_array_equal(getattr(alone, field.name), getattr(shared, field.name))


def test_training_lowers_the_loss_and_writes_both_files(tmp_path):
    from tools.train_prior import TrainConfig, train

    out = tmp_path / "weights.npz"
    record = train(TrainConfig(out=out, scenes=8, test_scenes=2, epochs=6, batch=4, seed=1, workers=1))
    assert out.stat().st_size < 1_000_000
    assert json.loads(out.with_suffix(".json").read_text()) == record
    # Always answering one half costs log 2.
    assert record["scores"]["known_families"]["loss"] < np.log(2)
