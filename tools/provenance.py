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

    program = Path(sys.argv[0])
    module = program.suffix == ".py" and program.stem != "__main__"
    name = f"python -m {program.stem}" if module else program.name
    command = shlex.join([*shlex.split(name), *sys.argv[1:]])
    machine = f"{os.cpu_count()} cores ({platform.machine()}), Python {platform.python_version()}"
    return (
        f"Written by `{command}`: contramap {version()}, {date.today().isoformat()}, {machine}, "
        f"torch {installed('torch')}."
    )


def with_provenance(title: str, tables: str) -> bytes:
    """A markdown file: title, where it comes from, tables."""
    return f"# {title}\n\n{provenance()}\n\n{tables.strip()}\n".encode()
