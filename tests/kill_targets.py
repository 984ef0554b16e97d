"""Commands to be killed: what they are given, what they leave, and what counts as whole.

Known results come from a run that nobody disturbs. Each command runs in a fork of this process.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any


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
    except BaseException:
        traceback.print_exc()
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


def frame_at(folder: Path, radius: float) -> Path:
    """A frame of one ball on a table, 80x60."""
    from conftest import Shape, make_tabletop

    from perception import save_frame

    save_frame(make_tabletop((Shape("sphere", (radius,), (0.0, 0.0, radius)),), size=(80, 60)).frame, folder)
    return folder


def of_map(work: Path, name: str, but: set[int]) -> Target:
    """`contramap map` into a new folder, or in turn of two frames over the older result."""
    from reconstruction.files.result_folder import load_result

    overwrite, root = name == "overwrite", work / name
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


def of_scenes(work: Path, name: str, but: set[int]) -> Target:
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


def of_evaluate(work: Path, name: str, but: set[int]) -> Target:
    """`contramap evaluate` of two scenes with two workers."""
    from benchmark_scenes import write_scenes

    from tools.evaluation.job import Job

    engine = "ray" if name == "ray" else "local"
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


def of_fetch(work: Path, name: str, but: set[int]) -> Target:
    """`contramap fetch ycb` of three archives from a server of this machine."""
    from test_fetch import archive

    root, known = work / name, work / f"{name}_known"
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

    return Target(name, arguments, whole, start_over, root)


TARGETS = {
    "map": of_map,
    "overwrite": of_map,
    "scenes": of_scenes,
    "cutting": of_scenes,
    "evaluate": of_evaluate,
    "ray": of_evaluate,
    "fetch": of_fetch,
}
"""Name -> its target, from a folder to work in, the name, and the set of processes that are none of the
command's, to which a server that it talks to is added."""
