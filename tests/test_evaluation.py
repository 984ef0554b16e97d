"""The evaluation: scores on cases with known answers, and runs that can be killed, spread and trusted."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import dying_worker
import numpy as np
import pytest
from benchmark_scenes import write_scenes

from mapping.errors import ConfigError, DataError
from reconstruction.metrics import inside, mesh_iou
from reconstruction.solid import Solid
from tools.evaluation.answers import Answers, ask, coarse_answers
from tools.evaluation.case import Case, load_case
from tools.evaluation.command import evaluate, find_scenes, finish
from tools.evaluation.engine import run_local, run_ray
from tools.evaluation.fitted_map import FittedMap
from tools.evaluation.job import Job, Run, run_job
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
from tools.evaluation.summary import json_lines, paired_tests, read_results, summarise
from tools.evaluation.table import shape_rows
from tools.evaluation.uncertainty_card import distance_to_samples, uncertainty_card
from tools.markdown import markdown_table
from tools.runs.failures import RunsFailed

REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scenes(tmp_path_factory.mktemp("scenes"))


@pytest.fixture(scope="module")
def case(scenes: Path) -> Case:
    return load_case(scenes / "scene_0000")


@pytest.fixture(scope="module")
def undisturbed(scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The output folder of an evaluation that ran through."""
    out = tmp_path_factory.mktemp("undisturbed")
    evaluate(scenes, out=out, methods=("tsdf", "hilbert"), seeds=(0,), gallery=0)
    return out


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


def test_the_output_is_complete(undisturbed: Path) -> None:
    summary = json.loads((undisturbed / "summary.json").read_text())
    assert summary["scenes"] == 2
    assert list(summary["methods"]) == ["tsdf", "hilbert"]
    entry = summary["methods"]["hilbert"]
    for metric in ("iou", "chamfer_mm", "fscore_5mm", "occlusion_auroc", "error_auroc", "aurc", "ause"):
        assert set(entry[metric]) >= {"mean", "std"}
    assert 0.3 < entry["iou"]["mean"] < 1
    assert entry["missing"] == 0
    assert entry["fit_s"] > 0
    assert len((undisturbed / "results.jsonl").read_text().splitlines()) == 4
    page = (undisturbed / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 6
    assert 'src="http' not in page
    assert "hilbert" in page


@pytest.mark.slow
def test_a_killed_evaluation_goes_on_to_the_same_table(
    scenes: Path, undisturbed: Path, tmp_path: Path
) -> None:
    script = tmp_path / "call.py"
    script.write_text(
        "from pathlib import Path\nfrom tools.evaluation.command import evaluate\n"
        "if __name__ == '__main__':\n"
        f"    evaluate(Path({str(scenes)!r}), out=Path({str(tmp_path)!r}), "
        "methods=('tsdf', 'hilbert'), seeds=(0,), gallery=0)\n"
    )
    process = subprocess.Popen(
        [sys.executable, str(script)],
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        deadline = time.monotonic() + 120
        while not list(tmp_path.glob("runs/*/*.json")) and time.monotonic() < deadline:
            assert process.poll() is None
            time.sleep(0.05)
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.glob("runs/*/*.json")}
    assert 0 < len(kept) < 4
    evaluate(scenes, out=tmp_path, methods=("tsdf", "hilbert"), seeds=(0,), gallery=0)
    assert all(path.stat().st_mtime_ns == time_ns for path, time_ns in kept.items())
    assert _without_times(tmp_path) == _without_times(undisturbed)


def test_a_broken_scene_is_reported_and_the_rest_go_on(scenes: Path, tmp_path: Path) -> None:
    mixed = tmp_path / "scenes"
    shutil.copytree(scenes, mixed)
    (mixed / "scene_0000" / "depth.png").write_bytes(b"no picture")
    jobs = [Job(mixed / f"scene_000{i}", (0,), ("tsdf",), tmp_path) for i in (0, 1)]
    failures = [failure for job in jobs for failure in run_job(job)]
    assert [(failure["scene"], failure["method"]) for failure in failures] == [("scene_0000", "tsdf")]
    assert "depth.png" in failures[0]["error"]
    with pytest.raises(RunsFailed, match="1 of 2 runs failed"):
        finish(jobs, failures, 0, None)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["scenes"] == 1
    assert summary["failures"] == failures


def test_a_dead_worker_costs_one_method_only(scenes: Path, tmp_path: Path, monkeypatch) -> None:
    failures: list[dict[str, str]] = []
    jobs = [Job(scenes / f"scene_000{i}", (0,), ("tsdf",), tmp_path) for i in (0, 1)]
    monkeypatch.setattr("tools.evaluation.engine.run_job", dying_worker.run)
    run_local(jobs, 1, lambda job, failed: failures.extend(failed))
    assert [failure["scene"] for failure in failures] == ["scene_0000"]
    assert "died" in failures[0]["error"]
    assert jobs[1].result_file(Run(0, "tsdf")).is_file()


@pytest.mark.slow
def test_ray_gives_the_same_numbers(scenes: Path, undisturbed: Path, tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="ray is not installed (extra `cluster`)")
    jobs = [Job(scenes / f"scene_000{i}", (0,), ("tsdf", "hilbert"), tmp_path) for i in (0, 1)]
    failures: list[dict[str, str]] = []
    run_ray(jobs, 2, lambda job, failed: failures.extend(failed))
    assert not failures
    assert _without_times(tmp_path) == _without_times(undisturbed)


def test_results_of_other_scenes_are_not_mixed(scenes: Path, undisturbed: Path, tmp_path: Path) -> None:
    other = tmp_path / "scenes"
    shutil.copytree(scenes, other)
    truth = other / "scene_0000" / "truth.json"
    truth.write_text(truth.read_text().replace('"seed": 0', '"seed": 1'))
    with pytest.raises(ConfigError, match="choose another --out"):
        evaluate(other, out=undisturbed, methods=("tsdf",), seeds=(0,), gallery=0)


def test_refusals(scenes: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="valid methods: contramap, "):
        evaluate(scenes, out=tmp_path, methods=("magic",))
    with pytest.raises(DataError, match="contramap scenes"):
        find_scenes(tmp_path, None)


def test_the_summary_pairs_scenes(scenes: Path, undisturbed: Path) -> None:
    files = sorted(undisturbed.glob("runs/*/*.json"))
    results = read_results(files)
    (test,) = [item for item in paired_tests(results) if item["metric"] == "iou"]
    means = summarise(results)["methods"]
    a, b = means[test["a"]]["iou"]["mean"], means[test["b"]]["iou"]["mean"]
    assert test["difference"] == pytest.approx(a - b)  # every scene has two objects
    assert test["scenes"] == 2
    assert len(json_lines(results)) < 700 * len(results)
    assert markdown_table(shape_rows(summarise(results))).count("\n") == 4


def test_a_job_does_only_what_is_missing(scenes: Path, tmp_path: Path) -> None:
    job = Job(scenes / "scene_0000", (0,), ("tsdf",), tmp_path)
    assert job.missing() == [Run(0, "tsdf")]
    assert run_job(job) == []
    written = job.result_file(Run(0, "tsdf")).stat().st_mtime_ns
    assert job.missing() == []
    assert run_job(job) == []
    assert job.result_file(Run(0, "tsdf")).stat().st_mtime_ns == written


def test_a_method_without_randomness_is_fitted_once_for_all_seeds(
    scenes: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def counted(case: Case, name: str, seed: int) -> Answers:
        asked.append((name, seed))
        return ask(case, name, seed)

    monkeypatch.setattr("tools.evaluation.job.ask", counted)
    job = Job(scenes / "scene_0000", (0, 1), ("hilbert", "tsdf"), tmp_path)
    assert run_job(job) == []
    assert asked == [("hilbert", 0), ("tsdf", 0), ("hilbert", 1)]
    first, second = (json.loads(job.result_file(Run(seed, "tsdf")).read_text()) for seed in (0, 1))
    alone = Job(scenes / "scene_0000", (1,), ("tsdf",), tmp_path / "alone")
    assert run_job(alone) == []
    again = json.loads(alone.result_file(Run(1, "tsdf")).read_text())
    assert again["objects"] == second["objects"] != first["objects"]  # the metrics' points differ
    assert again["card"] == second["card"] == first["card"]


def _without_times(out: Path) -> dict[str, dict]:
    found = {}
    for path in sorted(out.glob("runs/*/*.json")):
        content = json.loads(path.read_text())
        found[path.relative_to(out).as_posix()] = {k: v for k, v in content.items() if not k.endswith("_s")}
    return found
