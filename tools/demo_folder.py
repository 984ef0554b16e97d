"""Which scene a demo may replace: its own, and nothing that was put there or made by another command."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from zlib import crc32

from mapping.errors import ConfigError, DataError
from mapping.files import is_temporary, write_atomically
from mapping.guarded_files import read_json

MARK = "demo.json"
"""In the demo's folder: the scene it made, file by file."""


def clear_scene(out: Path, scene: str) -> None:
    """Remove the scene that an earlier demo made in `out`. Raises ConfigError when it is anything else."""
    folder = out / scene
    if not folder.exists():
        return
    try:
        made = read_json(out / MARK)["files"]
    except (DataError, KeyError, TypeError):
        made = None
    if made != checksums(folder):
        raise ConfigError(
            f"{folder} is there and is not (or no more) what a demo made, so it is not replaced; "
            "choose another --out, or move it away"
        )
    shutil.rmtree(folder)


def remember_scene(out: Path, scene: Path) -> None:
    """Note what the demo made, so that the next one may replace it."""
    content = {"scene": scene.name, "files": checksums(scene)}
    write_atomically(out / MARK, (json.dumps(content, indent=1) + "\n").encode())


def checksums(folder: Path) -> dict[str, int]:
    """Path below a folder -> checksum of each file's content."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and not is_temporary(path))
    return {path.relative_to(folder).as_posix(): crc32(path.read_bytes()) for path in files}
