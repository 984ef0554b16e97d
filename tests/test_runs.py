"""Workers, signals, kept results and forks: what long commands share."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from mapping.errors import DataError
from sim_scenes.truth import TRUTH_FILE
from tools.evaluation.command import check_same_scenes, find_scenes
from tools.evaluation.job import NULL_METHOD, RESULT_FORMAT, RESULT_KEYS, Job, Run
from tools.exit_code import exit_code
from tools.runs.failures import RunsFailed
from tools.runs.kept import read_kept
from tools.runs.signals import Stopped, handlers_kept, stopped_by_signals
from tools.runs.workers import map_in_workers, run_in_workers

ENVIRONMENT = {**os.environ, "PYTHONPATH": os.pathsep.join([*sys.path, str(Path(__file__).parent)])}


def square_or_die(number: int) -> int:
    """Dies of a negative number, fails at 100, waits at 7 and above."""
    if number < 0:
        os._exit(9)
    if number == 100:
        raise ValueError("too large")
    time.sleep(0.3 if number >= 7 else 0)
    return number**2


def sleep_long(seconds: float) -> None:
    print(os.getpid(), flush=True)
    time.sleep(seconds)


def alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().split(") ")[1][0] != "Z"
    except FileNotFoundError:
        return False


def until(condition, seconds: float = 30) -> bool:
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.05)
    return condition()


def test_a_dead_worker_costs_the_task_it_had_and_no_other() -> None:
    tasks = [1, 7, -1, 2, 100, 8, -2, 3]
    found = {done.task: done for done in run_in_workers(square_or_die, tasks, 2)}
    assert set(found) == set(tasks)
    assert [number for number, done in found.items() if done.died] == [-1, -2]
    assert str(found[100].error) == "too large"
    assert {number: found[number].result for number in (1, 7, 2, 8, 3)} == {1: 1, 7: 49, 2: 4, 8: 64, 3: 9}


def test_a_worker_that_dies_with_nothing_to_do_costs_no_task() -> None:
    """The task it would have had is not lost between the queue and the worker."""
    import multiprocessing

    iterator = run_in_workers(abs, [-2, -3], 1)
    assert next(iterator).result == 2
    (idle,) = multiprocessing.active_children()
    idle.kill()
    idle.join()
    assert [(over.task, over.result, over.died) for over in iterator] == [(-3, 3, False)]


def die_once(path: str) -> str:
    """Dies when there is no file at the path, which it makes."""
    if not Path(path).exists():
        Path(path).touch()
        os._exit(9)
    return path


@pytest.mark.slow
def test_results_in_order_and_one_more_try_for_those_that_died(tmp_path: Path) -> None:
    assert list(map_in_workers(square_or_die, [7, 1, 8, 2], 2)) == [49, 1, 64, 4]
    paths = [str(tmp_path / name) for name in "abc"]
    Path(paths[0]).touch()
    assert list(map_in_workers(die_once, paths, 2)) == paths
    with pytest.raises(ValueError, match="too large"):
        list(map_in_workers(square_or_die, [1, 100], 2))
    with pytest.raises(DataError, match="twice"):
        list(map_in_workers(square_or_die, [1, -1], 2))


def test_workers_end_with_the_iterator() -> None:
    import multiprocessing

    iterator = run_in_workers(square_or_die, [1, 2, 7, 7, 7, 7], 2)
    next(iterator)
    iterator.close()
    assert multiprocessing.active_children() == []


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks processes up in /proc")
@pytest.mark.parametrize(
    ("number", "code"),
    [
        ("SIGKILL", -9),
        pytest.param("SIGTERM", 143, marks=pytest.mark.slow),
        pytest.param("SIGHUP", 129, marks=pytest.mark.slow),
    ],
)
def test_no_worker_outlives_a_command_that_is_killed(tmp_path: Path, number: str, code: int) -> None:
    program = tmp_path / "program.py"
    program.write_text(
        "import sys\nfrom test_runs import sleep_long\nfrom tools.exit_code import exit_code\n"
        "from tools.runs.workers import run_in_workers\n"
        "if __name__ == '__main__':\n"
        "    sys.exit(exit_code('x', lambda: list(run_in_workers(sleep_long, [99.0, 99.0], 2))))\n"
    )
    command = subprocess.Popen(
        [sys.executable, str(program)],
        env=ENVIRONMENT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert command.stdout is not None
    workers = [int(command.stdout.readline()) for _ in range(2)]
    assert all(alive(worker) for worker in workers)
    command.send_signal(getattr(signal, number))
    assert command.wait(30) == code
    assert until(lambda: not any(alive(worker) for worker in workers))
    assert command.stderr is not None
    said = command.stderr.read()
    assert "Traceback" not in said
    assert (f"x: ended by {number}" in said) == (number != "SIGKILL")


def take_over_and_be_ended() -> None:
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(number))
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(5)  # until the handler is called


def be_ended_and_fail() -> None:
    """What compiled code makes of an exception that a handler raised in it."""
    try:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(5)
    except Stopped:
        raise RuntimeError("system error") from None


def test_a_library_that_takes_signals_over_takes_none_away() -> None:
    """Ray's handler is there while Ray starts, and ends the process in its own way."""
    before = signal.getsignal(signal.SIGTERM)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        with stopped_by_signals():
            ours = signal.getsignal(signal.SIGTERM)
            with handlers_kept():
                signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(number))
            assert signal.getsignal(signal.SIGTERM) is ours
            with pytest.raises(Stopped, match="SIGTERM"), handlers_kept():
                take_over_and_be_ended()
        with pytest.raises(Stopped, match="SIGTERM"), stopped_by_signals():
            be_ended_and_fail()
    finally:
        signal.signal(signal.SIGTERM, before)


def test_exit_codes(capsys: pytest.CaptureFixture[str]) -> None:
    def run(error: BaseException):
        def raise_it() -> None:
            raise error

        return exit_code("x", raise_it)

    assert run(RunsFailed("2 of 4 runs failed")) == 1
    assert run(DataError("bad")) == 2
    assert run(Stopped(signal.SIGTERM)) == 143
    assert capsys.readouterr().err.count("\n") == 3


def good_result(**changes: object) -> str:
    content = dict.fromkeys(RESULT_KEYS, 0) | {"format": RESULT_FORMAT, **changes}
    return json.dumps(content)


@pytest.mark.parametrize(
    "content",
    [
        "",
        "{",
        "[]",
        "null",
        '{"scene": 1}',
        good_result(format=1),
        "[" * 100_000,
        '{"a": "' + chr(0xFFFF) + '"}',
    ],
)
def test_results_broken_or_of_another_version_are_measured_again(tmp_path: Path, content: str) -> None:
    scene = tmp_path / "scenes" / "scene_0000"
    scene.mkdir(parents=True)
    (scene / TRUTH_FILE).write_text("{}")
    job = Job(scene, (0,), ("tsdf",), tmp_path)
    path = job.result_file(Run(0, "tsdf"))
    path.parent.mkdir(parents=True)
    path.write_text(content)
    assert job.missing() == [Run(0, "tsdf")]
    check_same_scenes([job])
    path.write_text(good_result(fingerprint=job.fingerprint))
    assert job.missing() == []


def test_a_cut_entropy_file_is_made_again(tmp_path: Path) -> None:
    job = Job(tmp_path / "scene_0000", (0,), (NULL_METHOD, "tsdf"), tmp_path)
    null = job.null_file(0)
    null.parent.mkdir(parents=True)
    for run in job.runs:
        job.result_file(run).write_text(good_result())
    np.save(null, np.ones(1000, np.float32))
    assert job.missing() == []
    null.write_bytes(null.read_bytes()[:300])
    assert job.missing() == [Run(0, NULL_METHOD)]
    null.unlink()
    assert job.missing() == [Run(0, NULL_METHOD)]


def test_left_overs_of_a_killed_scenes_command_are_no_scenes(tmp_path: Path) -> None:
    names = ("scene_0000", "scene_0001.4711.tmp", ".scene_0001.0123456789ab.part")
    for name in names:
        (tmp_path / name).mkdir()
        (tmp_path / name / TRUTH_FILE).write_text("{}")
    assert [path.name for path in find_scenes(tmp_path, None)] == ["scene_0000"]


def test_kept_results_need_their_keys(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    assert read_kept(path, ()) is None
    path.write_text('{"a": 1, "b": 2}')
    assert read_kept(path, ("a",), b=2) == {"a": 1, "b": 2}
    assert read_kept(path, ("a",), b=3) is None
    assert read_kept(path, ("c",)) is None
