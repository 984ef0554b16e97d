"""Where a table comes from: command, release, machine and day. Knows nothing of what is in it."""

from __future__ import annotations

import os
import shlex
import sys
from pathlib import Path


def provenance() -> str:
    """One line for the head of a written table: command, release, day and machine."""
    import platform
    from datetime import date
    from importlib.metadata import version as installed

    from mapping.version import version

    command = shlex.join([*_program(Path(sys.argv[0])), *sys.argv[1:]])
    machine = f"{os.cpu_count()} cores ({platform.machine()}), Python {platform.python_version()}"
    return (
        f"Written by `{command}`: contramap {version()}, {date.today().isoformat()}, {machine}, "
        f"torch {installed('torch')}."
    )


def _program(path: Path) -> list[str]:
    """How the running program is called: contramap, or python -m tools.real_frames."""
    package = Path(__file__).resolve().parents[1]
    if path.suffix != ".py" or not path.resolve().is_relative_to(package):
        return [path.name]
    module = ".".join(path.resolve().relative_to(package).with_suffix("").parts)
    return ["contramap"] if module == "tools.cli" else ["python", "-m", module]


def with_provenance(title: str, tables: str) -> bytes:
    """A markdown file: title, where it comes from, tables."""
    return f"# {title}\n\n{provenance()}\n\n{tables.strip()}\n".encode()
