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


@pytest.mark.slow
def test_training_lowers_the_loss_and_writes_both_files(tmp_path):
    from tools.train_prior import TrainConfig, train

    out = tmp_path / "weights.npz"
    record = train(TrainConfig(out=out, scenes=8, test_scenes=2, epochs=6, batch=4, seed=1, workers=1))
    assert out.stat().st_size < 2_000_000
    assert json.loads(out.with_suffix(".json").read_text()) == record
    # Always answering one half costs log 2.
    assert record["scores"]["known_families"]["loss"] < np.log(2)


def test_a_graphics_card_would_be_told_the_same():
    import torch

    from reconstruction.prior.features import LATTICE
    from reconstruction.prior.network import PriorNetwork
    from tools.prior_batches import sampled

    network, rng = PriorNetwork(), torch.Generator().manual_seed(0)
    features = torch.rand((2, 24, *(side // 2 for side in LATTICE)), generator=rng)
    local = 2.4 * torch.rand((2, 50, 3), generator=rng) - 1.2  # some beyond the lattice
    owner = np.arange(2, dtype=np.int32).repeat(50)
    near = network._near(features, owner, local.reshape(-1, 3)).reshape(2, 50, -1)
    torch.testing.assert_close(sampled(features, local), near, atol=1e-5, rtol=0)


def test_weights_gone_on_from_are_kept_in_part():
    from mapping.errors import ConfigError
    from reconstruction.prior.network import PriorNetwork
    from tools.train_prior import TrainConfig, mixed, train

    one, other = PriorNetwork(), PriorNetwork()
    expected = 0.75 * one.enter.weight + 0.25 * other.enter.weight
    np.testing.assert_allclose(mixed(one, other, 0.25).enter.weight.detach(), expected.detach(), atol=1e-6)
    with pytest.raises(ConfigError, match="--keep"):
        train(TrainConfig(keep=0.5))


def test_weights_without_their_record_are_named_before_anything_is_made(tmp_path):
    from mapping.errors import DataError
    from reconstruction.prior.occlusion_prior import WEIGHTS_FILE
    from tools.train_prior import TrainConfig, train

    alone = tmp_path / "alone.npz"
    alone.write_bytes(WEIGHTS_FILE.read_bytes())
    with pytest.raises(DataError, match=r"alone\.json"):
        train(TrainConfig(start=alone))
    with pytest.raises(DataError, match="no such weights"):
        train(TrainConfig(start=tmp_path / "none.npz"))


def test_a_missing_graphics_card_is_said():
    import torch

    from mapping.errors import ConfigError
    from tools.train_prior import TrainConfig, train

    if torch.cuda.is_available():
        pytest.skip("there is one")
    with pytest.raises(ConfigError, match="no graphics card"):
        train(TrainConfig(device="cuda"))


def test_mirrored_batches_are_those_of_a_mirrored_world():
    import torch

    from tools.prior_batches import Y_CHANNEL, Batches
    from tools.prior_data import make_examples

    batch = Batches(make_examples(1, draw_shape, 2), torch.device("cpu")).at(np.array([0, 1]))
    turned = batch.mirrored(torch.tensor([True, False]))
    torch.testing.assert_close(turned.local[0], batch.local[0] * torch.tensor([1, -1, 1]))
    torch.testing.assert_close(turned.channels[0, :, Y_CHANNEL], -batch.channels[0, :, Y_CHANNEL])
    # The lattice's own y, at its cells: the same picture, its columns exchanged.
    torch.testing.assert_close(turned.lattices[0, Y_CHANNEL], batch.lattices[0, Y_CHANNEL])
    torch.testing.assert_close(turned.lattices[0, 0], batch.lattices[0, 0].flip(1))
    for before, after in zip(batch, turned):
        torch.testing.assert_close(before[1], after[1])
    again = turned.mirrored(torch.tensor([True, False]))
    for before, after in zip(batch, again):
        torch.testing.assert_close(before, after)


def test_household_meshes_to_learn_from_exclude_those_kept_to_judge_on(tmp_path):
    import trimesh

    from sim_scenes.objects.split import held_out
    from sim_scenes.training.household import Household, Meshes, held_out_kinds, training_names

    names = [f"{thing} number" for thing in ("mug", "pan", "tray", "vase", "pot", "cup", "jar", "tin", "bin")]
    names += [f"{first} {second}" for first in names[:3] for second in ("lid", "foot")]
    listed = []
    for index, name in enumerate(names):
        mesh = trimesh.creation.box([0.05, 0.06, 0.07 + 0.01 * index])
        mesh.export(tmp_path / f"{name}.ply")
        licence = "CC-BY-NC" if name == "cup number" else "MIT"
        item = {"file": f"{name}.ply", "kind": "solid", "licence": licence}
        listed.append({**item, "extents_m": list(mesh.extents), "volume_l": 1e3 * mesh.volume})
    kept = [name for name in names if held_out(name)]
    assert 0 < len(kept) < len(names)
    twin = next(item for item in listed if held_out(item["file"]))
    unfit = next(item for item in listed if not held_out(item["file"]) and item["licence"] == "MIT")
    unfit.update(extents_m=twin["extents_m"][::-1], volume_l=twin["volume_l"])  # a copy under another name
    (tmp_path / "SOURCES.json").write_text(json.dumps({"objects": listed}))
    learned = training_names(tmp_path)
    assert set(learned).isdisjoint(kept)
    assert set(names) - set(kept) - set(learned) == {unfit["file"][:-4], "cup number"} - set(kept)
    assert {name for name, _ in held_out_kinds(tmp_path)} == set(kept)
    draw = Household(tmp_path, learned, 1.0)
    shapes = [draw(np.random.default_rng(seed)) for seed in range(40)]
    longest = [np.ptp(shape.parts[0].vertices, axis=0).max() for shape in shapes]
    assert min(longest) < 0.06 < 0.25 < max(longest) < 0.61
    assert Meshes(tmp_path, held_out_kinds(tmp_path))(np.random.default_rng(0)).family == "solid"
