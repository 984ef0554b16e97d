"""Killed at any moment, or on a full disk: the old result or the new one is in place, and nothing else."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import make_tabletop
from solids import reconstructed_tabletop

from mapping.errors import DataError
from mapping.files import is_temporary
from reconstruction import reconstruct
from reconstruction.files import result_folder
from reconstruction.files.output_folder import written_files
from reconstruction.files.result_folder import load_result, save_reconstruction

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
def test_memory_descriptors_and_threads_stay_flat() -> None:
    frame = make_tabletop(size=(160, 120)).frame

    def held() -> tuple[float, int, int]:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        return (
            pages * os.sysconf("SC_PAGESIZE") / 2**20,
            len(os.listdir("/proc/self/fd")),
            threading.active_count(),
        )

    first = [item.mesh.vertices.copy() for item in reconstruct(frame).objects]
    for _ in range(20):
        reconstruct(frame)
    before = held()
    for _ in range(480):
        last = reconstruct(frame).objects
    after = held()
    assert after[0] - before[0] < 50  # [MB]
    assert after[1:] == before[1:]
    assert all((item.mesh.vertices == vertices).all() for item, vertices in zip(last, first, strict=True))
