"""The `contramap` command: finds the subcommand and runs it."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

from tools.benchmark import latency
from tools.command_line import parse, with_preset
from tools.demo import demo
from tools.evaluation.command import evaluate
from tools.exit_code import exit_code
from tools.export import export
from tools.grasping.command import grasps
from tools.look import look
from tools.map_frame import map_frame
from tools.occupancy.command import occupancy
from tools.reproduce import commands as reproduced
from tools.scaling import scaling
from tools.semantic.benchmark import semantic_benchmark
from tools.semantic.command import semantic
from tools.serve import serve
from tools.serving.benchmark import serve_benchmark
from tools.simulate import fetch_ycb, scenes
from tools.stream import stream
from tools.view import view

# torch's OpenMP threads spin while they wait; on a busy machine that slows the fit's many short steps down
# ten times. Read when torch is first imported, so it stands before anything that could.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

Command = Callable[..., Any]


def fetch() -> None:
    """Download data: `contramap fetch ycb`."""


def benchmark() -> None:
    """Time the pipeline, or try its grasps: `contramap benchmark latency | scaling | semantic | serve |
    grasps`."""


def reproduce() -> None:
    """Repeat the paper's experiments: `contramap reproduce toy | occupancy | semantic | hinges`."""


COMMANDS: dict[str, Command] = {
    "demo": demo,
    "map": map_frame,
    "stream": stream,
    "view": view,
    "look": look,
    "occupancy": occupancy,
    "semantic": semantic,
    "export": export,
    "serve": serve,
    "scenes": scenes,
    "fetch": fetch,
    "evaluate": evaluate,
    "benchmark": benchmark,
    "reproduce": reproduce,
}
GROUPS: dict[str, dict[str, Command]] = {
    "fetch": {"ycb": fetch_ycb},
    "benchmark": {
        "latency": latency,
        "scaling": scaling,
        "semantic": semantic_benchmark,
        "serve": serve_benchmark,
        "grasps": grasps,
    },
    "reproduce": {
        "toy": reproduced.toy,
        "occupancy": reproduced.occupancy,
        "semantic": reproduced.semantic,
        "hinges": reproduced.hinges,
    },
}
DESCRIPTION = (
    "RGB-D frames to metric object meshes with uncertainty. `contramap --version` says which release this is."
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line; returns the exit code."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    return exit_code("contramap", lambda: _run(arguments))


def _run(arguments: list[str]) -> None:
    if arguments == ["--version"]:
        from mapping.version import version

        print(f"contramap {version()}")
        return
    group = arguments[0] if arguments and arguments[0] in GROUPS else None
    commands = GROUPS[group] if group else COMMANDS
    call = parse(
        {name: with_preset(command, arguments) for name, command in commands.items()},
        prog=f"contramap {group}" if group else "contramap",
        description=COMMANDS[group].__doc__ if group else DESCRIPTION,
        arguments=arguments[1:] if group else arguments,
    )
    call()


if __name__ == "__main__":
    sys.exit(main())
