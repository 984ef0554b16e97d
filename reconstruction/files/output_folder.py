"""Whether a result may be written to a folder: what is there that is not the result's own stays.

Knows names of files and scene.json's list of them; knows nothing of meshes or maps.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from mapping.errors import ConfigError, DataError
from mapping.files import is_temporary
from mapping.folders import check_writable
from mapping.guarded_files import read_json

SCENE = "scene.json"
"""The file that makes a folder a result; it is written last."""
RECORDING = "recording.rrd"
"""`contramap view` adds it to results that have none."""
OWN = frozenset({SCENE, "map.npz", "field.npz", "overview.png", RECORDING, "objects", "frame"})
"""What results of earlier versions, which do not list their files, hold."""
OF_THE_SYSTEM = frozenset({".DS_Store", "Thumbs.db", "desktop.ini"})
"""File browsers leave these behind; they are nobody's data."""


def check_output(folder: Path, overwrite: bool = False) -> Path:
    """The absolute output folder, if a result may be written there; call it before long work.

    Raises ConfigError when the folder is not empty and overwrite is False, and, even with overwrite, when
    what is there is not a result folder or holds files that are not the result's; DataError when it cannot
    be written.
    """
    folder = absolute(folder)
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"{folder} is a file; the result needs a folder")
    check_writable(folder)
    check_replaceable(folder, overwrite)
    return folder


def check_replaceable(folder: Path, overwrite: bool = True) -> None:
    """Raise ConfigError when a folder holds anything that a new result may not replace."""
    held = entries(folder)
    if not held:
        return
    if not overwrite:
        raise ConfigError(f"output folder {folder} is not empty; choose another or pass --overwrite")
    scene = _scene(folder)
    if scene is None:
        raise ConfigError(
            f"{folder} is not empty and not a result folder (no scene.json of contramap), so it is not "
            "overwritten; choose another folder or empty it"
        )
    foreign = foreign_files(folder, scene)
    if foreign:
        raise ConfigError(
            f"{folder} also holds {foreign[0]}{f' and {len(foreign) - 1} more' if foreign[1:] else ''}, "
            "not of the result, so it is not overwritten; move it away or choose another folder"
        )


def absolute(folder: Path) -> Path:
    """The folder without symbolic links. Raises ConfigError for links that lead in a circle."""
    try:
        return Path(folder).resolve(strict=False)
    except (OSError, RuntimeError) as error:
        raise ConfigError(f"{folder}: its symbolic links lead in a circle; choose another folder") from error


def entries(folder: Path) -> list[Path]:
    """What a folder holds, unfinished and system files left out; nothing when it is not there."""
    try:
        found = sorted(folder.iterdir()) if folder.is_dir() else []
    except OSError as error:
        raise DataError(f"{folder}: cannot be read ({error.strerror}); choose another folder") from error
    return [entry for entry in found if not is_temporary(entry) and entry.name not in OF_THE_SYSTEM]


def written_files(folder: Path) -> list[str]:
    """Paths of all files below a folder, relative to it, sorted."""
    return sorted(
        (Path(base) / name).relative_to(folder).as_posix()
        for base, _, names in os.walk(folder)
        for name in names
    )


def foreign_files(folder: Path, scene: dict[str, Any]) -> list[str]:
    """Files and links below a result folder that the result did not bring, relative to it."""
    listed = scene.get("files")
    there = [
        name
        for name in written_files(folder)
        if Path(name).name not in OF_THE_SYSTEM and not is_temporary(Path(name.split("/")[0]))
    ]
    links = [entry.name for entry in folder.iterdir() if entry.is_symlink() and entry.is_dir()]
    if isinstance(listed, list):
        own = {SCENE, RECORDING, *map(str, listed)}
        return [*links, *(name for name in there if name not in own)]
    return [*links, *(name for name in there if name.split("/")[0] not in OWN)]


def _scene(folder: Path) -> dict[str, Any] | None:
    """The content of a result's scene.json; None when the folder is no result."""
    try:
        scene = read_json(folder / SCENE)
    except DataError:
        return None
    return (
        scene
        if isinstance(scene, dict) and str(scene.get("format", "")).startswith("contramap-result")
        else None
    )
