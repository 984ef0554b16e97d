"""The `contramap` command: finds the subcommand, and turns bad input into one line and exit code 2."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

from mapping.errors import ContraMapError
from tools.benchmark import latency
from tools.demo import demo
from tools.evaluate import evaluate
from tools.map_frame import map_frame
from tools.reproduce.commands import hinges, occupancy, toy
from tools.scaling import scaling
from tools.simulate import fetch_ycb, scenes
from tools.view import view

# torch's OpenMP threads spin while they wait; on a busy machine that slows the fit's many short steps down
# ten times. Read when torch is first imported, so it stands before anything that could.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

Command = Callable[..., Any]


def fetch() -> None:
    """Download data: `contramap fetch ycb`."""


def benchmark() -> None:
    """Time the pipeline: `contramap benchmark latency | scaling`."""


def reproduce() -> None:
    """Repeat the paper's experiments: `contramap reproduce toy | occupancy | hinges`."""


COMMANDS: dict[str, Command] = {
    "demo": demo,
    "map": map_frame,
    "view": view,
    "scenes": scenes,
    "fetch": fetch,
    "evaluate": evaluate,
    "benchmark": benchmark,
    "reproduce": reproduce,
}
GROUPS: dict[str, dict[str, Command]] = {
    "fetch": {"ycb": fetch_ycb},
    "benchmark": {"latency": latency, "scaling": scaling},
    "reproduce": {"toy": toy, "occupancy": occupancy, "hinges": hinges},
}
EXTRAS = {"pooch": "sim", "rerun": "viz", "matplotlib": "viz", "ray": "cluster"}
"""Package -> the extra that brings it."""
DESCRIPTION = "RGB-D frames to metric object meshes with uncertainty."


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line; returns the exit code."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    try:
        _run(arguments)
    except ContraMapError as error:
        print(f"contramap: error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except (ImportError, OSError) as error:
        if isinstance(error, BrokenPipeError):
            # The reader of our output (head, less) has gone; nothing is wrong.
            sys.stderr.close()
            return 0
        print(f"contramap: error: {' '.join(str(error).split())}{_advice(error)}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("contramap: interrupted", file=sys.stderr)
        return 130
    return 0


def _advice(error: Exception) -> str:
    """How to mend a missing library or package; empty for other errors."""
    text = str(error)
    if any(library in text for library in ("libusb", "libGL", "libgomp")):
        return "; open3d needs system libraries: sudo apt-get install -y libusb-1.0-0 libgl1 libgomp1"
    package = error.name.split(".")[0] if isinstance(error, ImportError) and error.name else None
    if package == "pybullet":
        return "; pybullet has wheels for Python 3.10 and 3.11: pip install 'contramap[sim]'"
    return f"; pip install 'contramap[{EXTRAS[package]}]'" if package in EXTRAS else ""


def _run(arguments: list[str]) -> None:
    import tyro

    group = arguments[0] if arguments and arguments[0] in GROUPS else None
    tyro.extras.subcommand_cli_from_dict(
        GROUPS[group] if group else COMMANDS,
        prog=f"contramap {group}" if group else "contramap",
        description=COMMANDS[group].__doc__ if group else DESCRIPTION,
        args=arguments[1:] if group else arguments,
        config=(tyro.conf.FlagCreatePairsOff,),
    )


if __name__ == "__main__":
    sys.exit(main())
