"""The ablation: its variants are what they say, and the table has them all."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from benchmark_scenes import write_scenes

from mapping.errors import ConfigError
from perception.space import Region
from reconstruction.config import TabletopSamples
from reconstruction.samples.tabletop import draw_tabletop
from reconstruction.samples.training_set import TrainingSet
from tools.ablation import ablation, single_factors, two_factors, variant
from tools.evaluation.case import Case, load_case
from tools.evaluation.methods import method


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scenes(tmp_path_factory.mktemp("scenes"))


@pytest.fixture(scope="module")
def case(scenes: Path) -> Case:
    return load_case(scenes / "scene_0000")


def test_noise_moves_and_keeps_its_mass(case: Case) -> None:
    shares, mass = {}, {}
    for noise in ("occluded", "near", "everywhere"):
        samples = TabletopSamples(noise=noise, prior="none")  # type: ignore[arg-type]
        training = draw_tabletop(samples, case.observation, case.space, np.random.default_rng(0))
        uncertain = training.y[:, -1] if noise == "occluded" else training.y[:, -1] == 1
        free = case.space.classify(training.X) == Region.FREE
        shares[noise] = uncertain[free].sum() / uncertain.sum()
        mass[noise] = training.y[:, -1].sum()
        np.testing.assert_allclose(training.y.sum(1), 1, atol=1e-5)
    assert shares["occluded"] < 0.02  # noise never falls into space a ray has passed through
    assert min(shares["near"], shares["everywhere"]) > 0.3
    assert max(mass.values()) - min(mass.values()) <= 0.05 * mass["occluded"]


def test_without_pairs_objects_are_sampled_on_their_surface(case: Case) -> None:
    on, off = (
        draw_tabletop(TabletopSamples(pairs=pairs), case.observation, case.space, np.random.default_rng(0))
        for pairs in (True, False)
    )
    assert len(off.X) < len(on.X)
    surface = case.observation.objects[0].points

    def on_surface(training: TrainingSet) -> int:
        inside = training.X[training.y[:, 1] > 0.5]
        return int((np.linalg.norm(inside[:, None] - surface[None], axis=2).min(1) < 1e-6).sum())

    assert on_surface(on) == 0
    assert on_surface(off) > 50


def test_variants_are_methods() -> None:
    names = [name for *_, name in (*single_factors(), *two_factors())]
    assert variant() == "contramap"
    assert variant("near", "none", pairs=False) == "contramap:noise=near,prior=none,pairs=false"
    assert len(set(names)) == 16
    for name in names:
        method(name)


def test_unknown_parts_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="valid: noise, prior, hinge points, surface pairs, surface"):
        ablation(tmp_path, out=tmp_path, parts=("magic",))


def test_unknown_settings_are_refused() -> None:
    with pytest.raises(ConfigError, match="valid in samples"):
        method("contramap:magic=1")
    with pytest.raises(ConfigError, match="valid in map"):
        method("contramap:map.magic=1")
    with pytest.raises(ConfigError, match="takes no settings"):
        method("hilbert:noise=near")


def test_a_method_may_carry_settings_of_any_section(case: Case) -> None:
    fitted = method("contramap:prior=none,map.fit.max_iterations=2").fit(case.view, np.random.default_rng(0))
    assert fitted.scene.map.report.iterations == 2  # type: ignore[attr-defined]


@pytest.mark.slow
def test_the_tables_are_complete_and_a_second_call_only_reads(scenes: Path, tmp_path: Path) -> None:
    ablation(scenes, out=tmp_path, limit=1)
    text = (tmp_path / "ablation.md").read_text()
    assert text.count("\n| ") == len(single_factors()) + len(two_factors()) + 2
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.glob("runs/*/*.json")}
    assert len(kept) == 13
    ablation(scenes, out=tmp_path, limit=1)
    assert all(path.stat().st_mtime_ns == time_ns for path, time_ns in kept.items())
    assert len(json.loads((tmp_path / "ablation.json").read_text())["methods"]) == 13
