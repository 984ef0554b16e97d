"""The evaluation as a command: complete, resumable, honest about failures."""

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
import pytest
from benchmark_scenes import write_scenes

from mapping.errors import ConfigError, DataError
from tools.evaluation.answers import Answers, ask
from tools.evaluation.case import Case
from tools.evaluation.command import evaluate, find_scenes, finish
from tools.evaluation.engine import run_local, run_ray
from tools.evaluation.job import Job, Run, run_job
from tools.evaluation.summary import json_lines, paired_tests, read_results, summarise
from tools.evaluation.table import shape_rows
from tools.markdown import markdown_table
from tools.runs.failures import RunsFailed

REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scenes(tmp_path_factory.mktemp("scenes"))


@pytest.fixture(scope="module")
def undisturbed(scenes: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The output folder of an evaluation that ran through."""
    out = tmp_path_factory.mktemp("undisturbed")
    evaluate(scenes, out=out, methods=("tsdf", "hilbert"), seeds=(0,), gallery=0)
    return out


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
    assert len(json_lines(results)) < 750 * len(results)
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
