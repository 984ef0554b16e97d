"""Killed at any moment, or on a full disk: the old result or the new one is in place, and nothing else."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from benchmark_scenes import write_scenes
from kill_targets import digest, without_times
from solids import reconstructed_tabletop

from mapping.errors import DataError
from mapping.files import is_temporary
from reconstruction.files import result_folder
from reconstruction.files.output_folder import written_files
from reconstruction.files.result_folder import load_result, save_reconstruction
from tools.cli import main

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")


@pytest.fixture(scope="module")
def two():
    """The same reconstruction with one object and with two."""
    whole = reconstructed_tabletop()
    return [
        dataclasses.replace(whole, objects=whole.objects[:n], fields=whole.fields[:n], other=None)
        for n in (1, 2)
    ]


def save_for_ever(two, out: Path) -> None:
    number = 0
    while True:
        save_reconstruction(two[number % 2], out, overwrite=True)
        number += 1


def kill_at_random(two, out: Path, rng: np.random.Generator) -> None:
    process = os.fork()
    if process == 0:
        try:
            save_for_ever(two, out)
        finally:
            os._exit(1)
    time.sleep(float(rng.uniform(0, 0.25)))
    os.kill(process, signal.SIGKILL)
    os.waitpid(process, 0)


def check_whole(out: Path) -> None:
    stored = load_result(out)
    assert len(stored.objects) in (1, 2)
    assert set(stored.scene["files"]) == set(written_files(out)) - {"scene.json"}


@pytest.mark.parametrize("count", [12, pytest.param(200, marks=pytest.mark.slow)])
def test_a_killed_overwrite_leaves_the_old_result_or_the_new_one(
    two, tmp_path: Path, monkeypatch, count
) -> None:
    # Drawing takes most of the time and writes one file like the others.
    monkeypatch.setattr(
        result_folder, "draw_overview", lambda r, path, truth: path.write_bytes(bytes(50_000))
    )
    out = tmp_path / "result"
    save_reconstruction(two[0], out)
    rng = np.random.default_rng(count)
    left = 0
    for _ in range(count):
        kill_at_random(two, out, rng)
        check_whole(out)
        left += any(is_temporary(path) for path in tmp_path.iterdir())
    assert left > 0  # some kills came in the middle of the work
    save_reconstruction(two[1], out, overwrite=True)
    check_whole(out)
    assert [path.name for path in tmp_path.iterdir()] == ["result"]


@pytest.mark.parametrize(
    "size",
    ["16k", "256k", "1m", *(pytest.param(s, marks=pytest.mark.slow) for s in ("64k", "4m", "16m", "64m"))],
)
def test_a_full_disk_of_any_size_leaves_the_old_result_or_nothing(two, tmp_path: Path, size: str) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(disk)]
    if not shutil.which("mount") or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("a small file system cannot be mounted here (needs root)")
    try:
        there = 0
        for number in (0, 1):
            try:
                save_reconstruction(two[number], disk / "result", overwrite=True)
                there = number + 1
            except DataError:  # no space is left; the next lines say what must be there
                pass
            held = [path.name for path in disk.iterdir()]
            assert held == (["result"] if there else [])
            if there:
                check_whole(disk / "result")
                assert len(load_result(disk / "result").objects) == there
        assert there or size in ("16k", "64k", "256k", "1m")
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=True)


def full_disk(folder: Path, size: str) -> Path:
    """A small file system of its own, mounted at a folder; unmounted by the caller."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)]
    if not shutil.which("mount") or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("a small file system cannot be mounted here (needs root)")
    return folder


SIZES = ["16k", "64k", "256k", "1m", "4m", "16m", "64m"]


def hidden(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if is_temporary(path)]


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES)
def test_scenes_on_a_full_disk_are_whole_or_absent(tmp_path: Path, size: str, monkeypatch) -> None:
    """And the same command, once there is room, ends with the scenes of an undisturbed run."""
    monkeypatch.setenv("CONTRAMAP_CACHE", str(tmp_path.parent / "cache"))
    arguments = ["--count", "2", "--seed", "3", "--objects", "builtin"]
    known = tmp_path.parent / "known_scenes"
    assert main(["scenes", str(known), *arguments]) == 0  # kept from the first size on
    disk = full_disk(tmp_path / "disk", size)
    try:
        code = main(["scenes", str(disk / "made"), *arguments])
        assert code == 0 if size in ("16m", "64m") else code in (0, 2)
        assert not hidden(disk)
        for scene in disk.glob("made/scene_*"):
            assert digest(scene) == digest(known / scene.name)
        subprocess.run(["mount", "-o", "remount,size=64m", str(disk)], check=True)
        assert main(["scenes", str(disk / "made"), *arguments]) == 0
        assert digest(disk / "made") == digest(known)
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=True)


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES)
def test_evaluations_on_a_full_disk_keep_whole_results(
    tmp_path: Path, size: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """What is there is whole, what failed is said, and with room the same command ends as usual."""
    scenes = tmp_path.parent / "scenes"
    if not scenes.exists():
        write_scenes(scenes)
    options = ["--methods", "tsdf", "hilbert", "--seeds", "0", "--workers", "2", "--gallery", "1"]
    known = tmp_path.parent / "known_evaluation"
    assert main(["evaluate", str(scenes), "--out", str(known), *options]) == 0
    disk = full_disk(tmp_path / "disk", size)
    try:
        capsys.readouterr()
        code = main(["evaluate", str(scenes), "--out", str(disk / "out"), *options])
        said = capsys.readouterr().err
        assert code == 0 or "No space left" in said or "failed" in said
        assert "Traceback" not in said
        assert not hidden(disk)
        for path in (disk / "out" / "runs").glob("*/*.json"):
            same = known / path.relative_to(disk / "out")
            found, wanted = (without_times("", json.loads(one.read_text())) for one in (path, same))
            assert found == wanted
        subprocess.run(["mount", "-o", "remount,size=64m", str(disk)], check=True)
        assert main(["evaluate", str(scenes), "--out", str(disk / "out"), *options]) == 0
        found, wanted = (
            without_times("", json.loads((folder / "summary.json").read_text()))
            for folder in (disk / "out", known)
        )
        assert found == wanted
        assert not hidden(disk)
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=True)


@pytest.mark.slow
@pytest.mark.parametrize(
    "counts",
    [["map=80"], ["overwrite=60"], ["scenes=15", "cutting=5"], ["evaluate=20"], ["ray=5"], ["fetch=15"]],
    ids=lambda counts: counts[0],
)
def test_200_kills_of_commands(counts: list[str], tmp_path: Path) -> None:
    """After each: whole results only and no process; after the next run: the same result and no more."""
    here = Path(__file__).parent
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([*sys.path, str(here)]),
        "OMP_NUM_THREADS": "1",
    }
    command = [sys.executable, str(here / "killing.py"), str(tmp_path / "work"), "--counts", *counts]
    answer = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert answer.returncode == 0, answer.stderr[-3000:]
    found = json.loads(answer.stdout)
    assert found.pop("temporary") == []
    assert [f"{name}={figures['kills']}" for name, figures in found.items()] == counts


@pytest.mark.slow
def test_memory_descriptors_and_threads_stay_flat(tmp_path: Path) -> None:
    """500 reconstructions in one process, then on four of its threads, in forks and in fresh processes."""
    here = Path(__file__).parent
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([*sys.path, str(here)]),
        "OMP_NUM_THREADS": "2",
    }
    answer = subprocess.run(
        [sys.executable, str(here / "long_runs.py"), "500"], env=environment, capture_output=True, text=True
    )
    assert answer.returncode == 0, answer.stderr[-3000:]
    found = json.loads(answer.stdout)
    assert found["results"] == 1
    before, *later = found["held"]
    memory = {row["after"]: row["mb"] for row in later}
    assert max(mb for after, mb in memory.items() if isinstance(after, int)) - before["mb"] < 50
    # The allocator keeps some for each thread, once.
    assert memory["threads again"] - memory["threads"] < 50
    assert {(row["descriptors"], row["threads"]) for row in found["held"]} == {
        (before["descriptors"], before["threads"])
    }
