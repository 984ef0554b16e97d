"""What goes wrong in a command as one line on stderr and an exit code, never a traceback."""

from __future__ import annotations

import sys
from collections.abc import Callable

from mapping.errors import ContraMapError
from tools.runs.signals import Stopped, stopped_by_signals

EXTRAS = {
    "pooch": "sim",
    "rerun": "viz",
    "matplotlib": "viz",
    "ray": "cluster",
    "coacd": "export",
    "manifold3d": "export",
    "pxr": "export",
    "rosbags": "export",
    "yaml": "export",
    "zmq": "serve",
    "msgpack": "serve",
}
"""Package -> the extra that brings it."""


def exit_code(name: str, run: Callable[[], object]) -> int:
    """Run a command: 0, 2 after bad input, a missing file or package or too little memory; 1 when some
    of many runs failed, 130 when interrupted, 128 + n when ended by signal n."""
    _print_whatever_the_console_takes()
    try:
        with stopped_by_signals():
            run()
    except Stopped as signal:
        print(f"{name}: {signal}", file=sys.stderr)
        return 128 + signal.number
    except ContraMapError as error:
        print(f"{name}: error: {' '.join(str(error).split())}", file=sys.stderr)
        return getattr(error, "exit_code", 2)
    except (ImportError, OSError) as error:
        if isinstance(error, BrokenPipeError):
            # The reader of our output (head, less) has gone; nothing is wrong.
            sys.stderr.close()
            return 0
        print(f"{name}: error: {' '.join(str(error).split())}{_advice(error)}", file=sys.stderr)
        return 2
    except MemoryError as error:
        detail = f" ({' '.join(str(error).split())})" if str(error) else ""
        print(
            f"{name}: error: out of memory{detail}; try a smaller image, a coarser lattice or fewer workers",
            file=sys.stderr,
        )
        return 2
    except KeyboardInterrupt:
        print(f"{name}: interrupted", file=sys.stderr)
        return 130
    return 0


def _print_whatever_the_console_takes() -> None:
    """Signs that the console has no letter for are written as escapes: a name must not cost the result."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _advice(error: Exception) -> str:
    """How to mend a missing library or package; empty for other errors."""
    text = str(error)
    if any(library in text for library in ("libusb", "libGL", "libgomp")):
        return "; open3d needs system libraries: sudo apt-get install -y libusb-1.0-0 libgl1 libgomp1"
    package = error.name.split(".")[0] if isinstance(error, ImportError) and error.name else None
    if package == "pybullet":
        return "; pybullet has wheels for Python 3.10 and 3.11: pip install 'contramap[sim]'"
    return f"; pip install 'contramap[{EXTRAS[package]}]'" if package in EXTRAS else ""
