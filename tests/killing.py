"""Kills commands at random moments and looks at what they leave; run as a program, whose process stays small.

    python tests/killing.py WORK --seed 0 --counts map=80 evaluate=20 ...   (by default all: 200 kills)

Each command runs in a fork of this process, which has imported everything and used nothing: a kill costs the
command and not five seconds of imports. Only kills of a command that was still at work count.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from kill_targets import TARGETS, Target, ended, start
from tqdm import tqdm

MARK = "CONTRAMAP_KILLING"
"""Set in the environment of this program, so that whatever it starts is found again in /proc."""
SIGNALS = (signal.SIGKILL, signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
PATIENCE_S = 120.0
"""Seconds that a command is given to end after a signal other than SIGKILL, and its processes after it; the
agents of Ray look for their raylet every few seconds, and less often on a busy machine."""
COUNTS = {"map": 80, "overwrite": 60, "scenes": 15, "cutting": 5, "evaluate": 20, "ray": 5, "fetch": 15}


@dataclass
class Figures:
    """What became of the kills of one command."""

    kills: int = 0
    ended: int = 0
    """Runs that were over before their moment came; they are not counted as kills."""
    left_hidden: int = 0
    """Kills after which something unfinished lay under a hidden name, until the next run."""
    seconds: float = 0.0
    """Of an undisturbed run."""
    signals: dict[str, int] = field(default_factory=dict)


def others(but: set[int]) -> list[int]:
    """Processes started by this program that are still there."""
    found = []
    mark = f"{MARK}={os.environ[MARK]}".encode()
    for folder in Path("/proc").iterdir():
        if not folder.name.isdigit() or int(folder.name) in but:
            continue
        try:
            if mark in (folder / "environ").read_bytes():
                found.append(int(folder.name))
        except OSError:
            continue
    return found


def nobody_left(but: set[int]) -> None:
    end = time.monotonic() + PATIENCE_S
    while left := others(but):
        if time.monotonic() > end:
            names = [Path(f"/proc/{one}/cmdline").read_bytes().replace(b"\0", b" ")[:200] for one in left]
            raise AssertionError(f"{len(left)} processes are left: {names}")
        time.sleep(0.02)


def hidden(root: Path) -> list[str]:
    """What lies below a folder under hidden or temporary names."""
    return [str(path) for path in root.rglob("*") if path.name.startswith((".", "tmp"))]


def kill_all(target: Target, count: int, rng: np.random.Generator, but: set[int]) -> Figures:
    """Kill a command so many times at random moments, then let it run through. Raises AssertionError."""
    figures = Figures()
    log = target.root.parent / f"{target.name}.log"

    def run_through() -> float:
        begin = time.monotonic()
        for number in range(4):  # what takes several runs is gone on with
            code = ended(start(target.arguments(number), log), 600)
            assert code == 0, f"{target.name} ended with {code}: {log.read_text()[-2000:]}"
            if target.whole():
                break
        assert target.whole(), f"{target.name}: not the result of an undisturbed run"
        nobody_left(but)
        assert not hidden(target.root), f"{target.name} left {hidden(target.root)}"
        return time.monotonic() - begin

    target.start_over()
    figures.seconds = longest = run_through()
    target.start_over()
    bar = tqdm(total=count, desc=target.name, mininterval=5)
    number = 0
    while figures.kills < count:
        number += 1
        bar.update(figures.kills - bar.n)
        which = SIGNALS[int(rng.integers(len(SIGNALS)))]
        process = start(target.arguments(number), log)
        if ended(process, float(rng.uniform(0, longest))) is not None:
            figures.ended += 1
            target.whole()
            target.start_over()
            continue
        os.kill(process, which)
        code = ended(process, PATIENCE_S)
        assert code is not None, f"{target.name} did not end after {which.name}"
        assert code != 70, f"{target.name} after {which.name}: {log.read_text()[-2000:]}"
        figures.kills += 1
        figures.signals[which.name] = figures.signals.get(which.name, 0) + 1
        nobody_left(but)
        if target.whole() and not target.name.startswith("overwrite"):
            target.start_over()
        figures.left_hidden += bool(hidden(target.root))
    bar.close()
    run_through()
    return figures


def draw_nothing(reconstruction: Any, path: Path, truth: Any) -> None:
    """In place of the overview."""
    path.write_bytes(bytes(50_000))


def main() -> None:
    if MARK not in os.environ:  # /proc shows the environment that a process was started with
        mark = f"{os.getpid()}-{time.time_ns()}"
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, MARK: mark})
    parser = argparse.ArgumentParser()
    parser.add_argument("work", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--pictures", action="store_true", help="draw result folders' pictures as well")
    parser.add_argument("--counts", nargs="*", default=[f"{name}={n}" for name, n in COUNTS.items()])
    given = parser.parse_args()
    counts = {name: int(n) for name, n in (text.split("=") for text in given.counts)}
    import reconstruction.files.result_folder
    import tools.cli  # noqa: F401

    if not given.pictures:
        # Drawing takes most of the time of `map` and writes one file like the others.
        reconstruction.files.result_folder.draw_overview = draw_nothing
    given.work.mkdir(parents=True)
    temporary = given.work / "tmp"
    temporary.mkdir()
    os.environ["TMPDIR"] = str(temporary)
    os.environ["RAY_TMPDIR"] = tempfile.mkdtemp(prefix="ray", dir="/tmp")  # paths of sockets must be short
    # Else its workers wait for everything else on a busy machine.
    os.environ["RAY_worker_niceness"] = "0"  # noqa: SIM112
    but = {os.getpid()}
    found: dict[str, Any] = {}
    for name, count in counts.items():
        target = TARGETS[name](given.work, name, but)
        begin = time.monotonic()
        figures = kill_all(target, count, np.random.default_rng([given.seed, len(found)]), but)
        found[name] = {**vars(figures), "took_s": round(time.monotonic() - begin, 1)}
        found[name]["seconds"] = round(figures.seconds, 2)
        print(name, json.dumps(found[name]), file=sys.stderr, flush=True)
    for process in but - {os.getpid()}:
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)
    shutil.rmtree(os.environ["RAY_TMPDIR"])  # Ray keeps its logs, after undisturbed runs as well
    found["temporary"] = sorted(path.name for path in temporary.iterdir())  # after the last, undisturbed run
    print(json.dumps(found))


if __name__ == "__main__":
    main()
