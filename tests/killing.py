"""Kills commands at random moments and looks at what they leave; run as a program, whose process stays small.

    python tests/killing.py WORK --seed 0 --counts map=80 evaluate=20 ...   (by default all: 200 kills)

Each command runs in a fork of this process, which has imported everything and used nothing: a kill costs the
command and not five seconds of imports. Only kills of a command that was still at work count.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

MARK = "CONTRAMAP_KILLING"
"""Set in the environment of this program, so that whatever it starts is found again in /proc."""
SIGNALS = (signal.SIGKILL, signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
PATIENCE_S = 120.0
"""Seconds that a command is given to end after a signal other than SIGKILL, and its processes after it; the
agents of Ray look for their raylet every few seconds, and less often on a busy machine."""
COUNTS = {"map": 80, "overwrite": 60, "scenes": 15, "cutting": 5, "evaluate": 20, "ray": 5, "fetch": 15}


@dataclass
class Target:
    """A command to be killed. arguments: of run number n; whole: raises unless what is in place is whole, and
    returns whether that is the final result; start_over: make the state before the first run."""

    name: str
    arguments: Callable[[int], list[str]]
    whole: Callable[[], bool]
    start_over: Callable[[], None]
    root: Path
    """Below it all that the command may leave."""


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


def start(arguments: list[str], log: Path) -> int:
    """The command in a fork of this process; its id."""
    process = os.fork()
    if process:
        return process
    code = 70
    try:
        out = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.dup2(out, 1)
        os.dup2(out, 2)
        from tools.cli import main

        code = main(arguments)
    except KeyboardInterrupt:  # before the command could say so
        code = 130
    finally:
        os._exit(code)


def ended(process: int, seconds: float) -> int | None:
    """The exit status of a process that ends within some seconds; None when it does not."""
    end = time.monotonic() + seconds
    while True:
        found, status = os.waitpid(process, os.WNOHANG)
        if found:
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() >= end:
            return None
        time.sleep(0.001)


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


def digest(folder: Path, plain: Callable[[str, Any], Any] = lambda name, content: content) -> str:
    """One number for the content of all files below a folder; JSON files pass through `plain` first."""
    found = hashlib.sha256()
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        name = path.relative_to(folder).as_posix()
        content = path.read_bytes()
        if path.suffix == ".json":
            content = json.dumps(plain(name, json.loads(content)), sort_keys=True).encode()
        found.update(name.encode() + b"\0" + content)
    return found.hexdigest()


def without_times(name: str, content: Any) -> Any:
    """What is measured with a clock differs from run to run."""
    if isinstance(content, dict):
        kept = {
            key: value for key, value in content.items() if not key.endswith("_s") and key != "timings_ms"
        }
        return {key: without_times(name, value) for key, value in kept.items()}
    if isinstance(content, list):
        return [without_times(name, value) for value in content]
    return content


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


def frame_at(folder: Path, radius: float) -> Path:
    """A frame of one ball on a table, 80x60."""
    from conftest import Shape, make_tabletop

    from perception import save_frame

    save_frame(make_tabletop((Shape("sphere", (radius,), (0.0, 0.0, radius)),), size=(80, 60)).frame, folder)
    return folder


def of_map(work: Path, overwrite: bool) -> Target:
    """`contramap map` into a new folder, or in turn of two frames over the older result."""
    from reconstruction.files.result_folder import load_result

    name = "overwrite" if overwrite else "map"
    root = work / name
    frames = [
        frame_at(work / f"{name}_frames" / str(n), 0.04 + 0.01 * n) for n in range(2 if overwrite else 1)
    ]
    options = ["--mesh.spacing", "0.006", *(["--overwrite"] if overwrite else [])]
    known: dict[str, str] = {}

    def arguments(number: int, out: Path = root / "result") -> list[str]:
        return ["map", str(frames[number % len(frames)]), "--out", str(out), *options]

    for number, frame in enumerate(frames):
        out = work / f"{name}_known" / frame.name
        assert ended(start(arguments(number, out), work / "known.log"), 600) == 0
        known[digest(out, without_times)] = frame.name

    def whole() -> bool:
        if not (root / "result").exists():
            assert not overwrite, "neither the old result nor the new one is in place"
            return False
        load_result(root / "result")
        assert digest(root / "result", without_times) in known, "not the result of an undisturbed run"
        return True

    def start_over() -> None:
        shutil.rmtree(root / "result", ignore_errors=True)
        if overwrite:
            shutil.copytree(work / f"{name}_known" / frames[0].name, root / "result")

    root.mkdir(parents=True)
    return Target(name, arguments, whole, start_over, root)


def of_scenes(work: Path, name: str) -> Target:
    """`contramap scenes`: two scenes of built-in objects; `cutting`: their collision shapes are cut anew."""
    root, known = work / name, work / f"{name}_known"
    os.environ["CONTRAMAP_CACHE"] = str(root / "cache")

    def arguments(number: int, out: Path = root / "made") -> list[str]:
        return ["scenes", str(out), "--count", "2", "--seed", "3", "--objects", "builtin"]

    root.mkdir(parents=True)
    assert ended(start(arguments(0, known), work / "known.log"), 600) == 0
    of_scene = {path.name: digest(path) for path in known.iterdir()}

    def whole() -> bool:
        there = [path for path in (root / "made").glob("scene_*") if path.is_dir()]
        for path in there:
            assert digest(path) == of_scene[path.name], f"{path} is another scene"
        return len(there) == len(of_scene)

    def start_over() -> None:
        shutil.rmtree(root / "made", ignore_errors=True)
        if name == "cutting":
            shutil.rmtree(root / "cache")

    return Target(name, arguments, whole, start_over, root)


def of_evaluate(work: Path, engine: str) -> Target:
    """`contramap evaluate` of two scenes with two workers."""
    from benchmark_scenes import write_scenes

    from tools.evaluation.job import Job

    name = "ray" if engine == "ray" else "evaluate"
    root, scenes = work / name, write_scenes(work / f"{name}_scenes")
    methods = ("tsdf", "hilbert")
    options = ["--methods", *methods, "--seeds", "0", "--workers", "2", "--engine", engine, "--gallery", "1"]

    def arguments(number: int, out: Path = root / "out") -> list[str]:
        return ["evaluate", str(scenes), "--out", str(out), *options]

    def table(out: Path) -> str:
        return digest(out / "runs", without_times) + json.dumps(
            without_times("", json.loads((out / "summary.json").read_text())), sort_keys=True
        )

    root.mkdir(parents=True)
    assert ended(start(arguments(0, work / f"{name}_known"), work / "known.log"), 600) == 0
    known = table(work / f"{name}_known")
    jobs = [Job(path, (0,), methods, root / "out") for path in sorted(scenes.iterdir())]

    def whole() -> bool:
        for job in jobs:
            for run in job.runs:
                there = job.result_file(run).exists()
                assert not there or job.kept(run) is not None, f"{job.result_file(run)} is broken"
        if not (root / "out" / "report.html").exists():
            return False
        assert table(root / "out") == known, "another table"
        return True

    def start_over() -> None:
        shutil.rmtree(root / "out", ignore_errors=True)

    return Target(name, arguments, whole, start_over, root)


class SlowHost(BaseHTTPRequestHandler):
    """Sends archives in pieces, so that a kill finds a download under way."""

    def do_GET(self) -> None:
        content = self.server.files[self.path.rsplit("/", 1)[-1]]  # type: ignore[attr-defined]
        asked = self.headers.get("Range")
        begin = int(asked.split("=")[1].rstrip("-")) if asked else 0
        if begin >= len(content):
            self.send_error(416)
            return
        self.send_response(206 if begin else 200)
        self.send_header("Content-Length", str(len(content) - begin))
        self.end_headers()
        try:
            for piece in range(begin, len(content), 1 << 16):
                self.wfile.write(content[piece : piece + (1 << 16)])
                time.sleep(0.01)
        except OSError:
            return  # the one who asked was killed

    def log_message(self, format: str, *args: Any) -> None:
        pass


def of_fetch(work: Path, but: set[int]) -> Target:
    """`contramap fetch ycb` of three archives from a server of this machine."""
    from test_fetch import archive

    root, known = work / "fetch", work / "fetch_known"
    models = ("003_cracker_box", "004_sugar_box", "005_tomato_soup_can")
    server = ThreadingHTTPServer(("127.0.0.1", 0), SlowHost)
    server.files = {f"{model}_google_16k.tgz": archive(model_id=model) for model in models}  # type: ignore[attr-defined]
    os.environ["CONTRAMAP_YCB_URL"] = f"http://127.0.0.1:{server.server_address[1]}"
    process = os.fork()
    if process == 0:
        try:
            server.serve_forever()
        finally:
            os._exit(0)
    but.add(process)
    server.server_close()

    def arguments(number: int, out: Path = root / "ycb") -> list[str]:
        return ["fetch", "ycb", "--to", str(out), "--only", *models]

    root.mkdir(parents=True)
    assert ended(start(arguments(0, known), work / "known.log"), 600) == 0
    all_of_it = digest(known)

    def whole() -> bool:
        there = [root / "ycb" / model for model in models if (root / "ycb" / model).exists()]
        for path in there:
            assert digest(path) == digest(known / path.name), f"{path} is another scan"
        return (root / "ycb").exists() and digest(root / "ycb") == all_of_it

    def start_over() -> None:
        shutil.rmtree(root / "ycb", ignore_errors=True)

    return Target("fetch", arguments, whole, start_over, root)


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
        if name in ("map", "overwrite"):
            target = of_map(given.work, name == "overwrite")
        elif name in ("scenes", "cutting"):
            target = of_scenes(given.work, name)
        elif name == "fetch":
            target = of_fetch(given.work, but)
        else:
            target = of_evaluate(given.work, "ray" if name == "ray" else "local")
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
