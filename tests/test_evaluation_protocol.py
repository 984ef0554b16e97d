"""What the evaluation measures: the truth scores as the truth, statistics are what their names say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from benchmark_scenes import write_scenes

from reconstruction.metrics import inside, mesh_iou
from reconstruction.solid import Solid
from tools.evaluation.answers import coarse_answers
from tools.evaluation.case import Case, load_case
from tools.evaluation.fitted_map import FittedMap
from tools.evaluation.methods import METHODS
from tools.evaluation.protocol import coarse_protocol
from tools.evaluation.statistics import (
    aurc,
    auroc,
    ause,
    brier,
    calibration_error,
    reliability,
    risk_coverage,
    spearman,
)
from tools.evaluation.uncertainty_card import distance_to_samples, uncertainty_card


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scenes(tmp_path_factory.mktemp("scenes"))


@pytest.fixture(scope="module")
def case(scenes: Path) -> Case:
    return load_case(scenes / "scene_0000")


class TrueMap(FittedMap):
    """Answers with the truth; sure where it was seen, unsure where it was hidden."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.samples = np.concatenate([item.points for item in case.observation.objects])

    def predict(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        probability = np.zeros((len(points), len(self.case.meshes) + 1), np.float32)
        for label, mesh in self.case.meshes.items():
            probability[:, self.case.index_of[label] + 1] = inside(mesh, points)
        probability[:, 0] = 1 - probability.sum(1)
        return probability, (self.case.space.classify(points) == 2).astype(np.float32)


def test_auroc() -> None:
    positive = np.array([0, 0, 1, 1], bool)
    assert auroc(np.array([1.0, 2, 3, 4]), positive) == 1
    assert auroc(np.array([4.0, 3, 2, 1]), positive) == 0
    assert auroc(np.ones(4), positive) == 0.5
    assert auroc(np.array([1.0, 3, 2, 4]), positive) == 0.75
    assert np.isnan(auroc(np.ones(4), np.ones(4, bool)))


def test_aurc_and_its_excess_over_the_oracle() -> None:
    wrong = np.array([0, 0, 1, 1], bool)
    np.testing.assert_allclose(risk_coverage(np.arange(4.0), wrong), [0, 0, 1 / 3, 1 / 2])
    assert aurc(np.arange(4.0), wrong) == pytest.approx(5 / 24)
    assert ause(np.arange(4.0), wrong) == pytest.approx(0)
    # Ties tell nothing: the error rate stays what it is at every coverage.
    np.testing.assert_allclose(risk_coverage(np.zeros(4), wrong), 0.5)
    worst = aurc(-np.arange(4.0), wrong)
    assert worst == pytest.approx((1 + 1 + 2 / 3 + 1 / 2) / 4)


def test_brier_and_calibration() -> None:
    probability = np.array([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]])
    assert brier(probability, np.array([0, 0, 0])) == pytest.approx((0 + 0.5 + 2) / 3)
    assert brier(probability[:1], np.array([-1])) == pytest.approx(2)
    rng = np.random.default_rng(0)
    confidence = rng.uniform(0.5, 1, 60_000)
    right = rng.random(60_000) < confidence
    assert calibration_error(reliability(confidence, right)) < 0.01
    assert calibration_error(reliability(np.full(1000, 0.9), np.zeros(1000, bool))) == pytest.approx(0.9)


def test_spearman_of_a_constant_is_unknown() -> None:
    assert spearman(np.arange(5.0), np.arange(5.0) ** 3) == pytest.approx(1)
    assert np.isnan(spearman(np.ones(5), np.arange(5.0)))


def test_the_truth_scores_as_the_truth(case: Case) -> None:
    found = coarse_protocol(coarse_answers(TrueMap(case), case), case, np.random.default_rng(0))
    assert set(found) == {1, 2}
    for item in found.values():
        assert item["iou"] == 1
        assert item["chamfer_mm"] < 11  # the floor of a binary field on a 15 mm grid
    probability, uncertainty = TrueMap(case).predict(case.card_voxels.points)
    scores, curves = uncertainty_card(probability, uncertainty, case.card_voxels)
    assert scores["occlusion_auroc"] == 1
    assert scores["error_rate"] == 0
    assert scores["aurc"] == 0
    assert curves["risk"][-1] == 0


def test_an_object_without_prediction_counts_as_missing(case: Case) -> None:
    class Nothing(TrueMap):
        def predict(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            probability = np.zeros((len(points), 3), np.float32)
            probability[:, 0] = 1
            return probability, np.ones(len(points), np.float32)

    found = coarse_protocol(coarse_answers(Nothing(case), case), case, np.random.default_rng(0))
    assert all(item == {"iou": 0.0, "chamfer_mm": None} for item in found.values())


def test_seen_cells_make_a_mesh_but_no_prediction(case: Case) -> None:
    class Faint(TrueMap):
        keeps_seen = True

        def predict(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            probability, uncertainty = super().predict(points)
            probability = 0.3 * probability
            probability[:, 0] = 1 - probability[:, 1:].sum(1)
            return probability, uncertainty

    found = coarse_protocol(coarse_answers(Faint(case), case), case, np.random.default_rng(0))
    for item in found.values():
        assert item["iou"] == 0
        assert item["chamfer_mm"] is not None


def test_iou_of_meshes_is_that_of_their_volumes(case: Case) -> None:
    mesh = case.meshes[1]
    assert mesh_iou(Solid(mesh), Solid(mesh), 0.005) == 1
    far = mesh.copy()
    far.apply_translation([0.2, 0, 0])
    assert mesh_iou(Solid(mesh), Solid(far), 0.005) == 0
    half = mesh.copy()
    half.apply_translation([0, 0, mesh.extents[2] / 2])
    assert mesh_iou(Solid(mesh), Solid(half), 0.004) == pytest.approx(1 / 3, abs=0.05)


def test_distance_to_samples() -> None:
    samples = np.array([[0.0, 0, 0], [1, 0, 0]])
    np.testing.assert_allclose(distance_to_samples(np.array([[0.25, 0, 0], [1, 0, 2]]), samples), [0.25, 2])


@pytest.mark.parametrize(
    "name", ["contramap", "contramap-paper", "hilbert", "vprism", "vprism-dense", "bayesian-hilbert"]
)
def test_every_map_finds_the_objects(case: Case, name: str) -> None:
    fitted = METHODS[name].fit(case.view, np.random.default_rng(0))
    points = np.concatenate([item.points[::50] for item in case.observation.objects])
    probability, uncertainty = fitted.predict(points.astype(np.float32))
    assert probability.shape == (len(points), 3)
    assert np.abs(probability.sum(1) - 1).max() < 0.15
    assert 0 <= uncertainty.min() <= uncertainty.max() <= 1 + 1e-6
    axes = [np.linspace(low, high, 7) for low, high in zip(points.min(0), points.max(0))]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3).astype(np.float32)
    direct = fitted.predict(nodes)[0][:, 1].reshape(7, 7, 7)
    lattice = fitted.occupancy(axes, 0)
    # Shortcuts on lattices may only touch nodes that are far from any object.
    assert ((lattice > 0.5) == (direct > 0.5)).all()
    found = coarse_protocol(coarse_answers(fitted, case), case, np.random.default_rng(0))
    assert np.mean([item["iou"] for item in found.values()]) > 0.3
