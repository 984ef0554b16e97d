"""Which rerun recording belongs to a result: recording.rrd in its folder, or the file that scene.json names.

Knows scene.json and files; knows nothing of rerun.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from mapping.files import write_atomically
from mapping.guarded_files import read_json
from reconstruction.files.output_folder import RECORDING, SCENE
from reconstruction.files.scene_json import to_json


def name_recording(folder: Path, recording: Path) -> None:
    """Write into the result's scene.json where its recording lies, and the file's SHA-256: another run may
    replace the file. A recording inside the folder is listed among the result's files.

    Raises DataError when scene.json cannot be read or written.
    """
    folder, recording = Path(folder).resolve(), Path(recording).resolve()
    scene = read_json(folder / SCENE)
    scene["recording"] = {"path": _relative(recording, folder), "sha256": _digest(recording)}
    if recording.is_relative_to(folder):
        own = {*scene.get("files", ()), recording.relative_to(folder).as_posix()}
        scene["files"] = sorted(own)
    write_atomically(folder / SCENE, to_json(scene).encode())


def recording_of(folder: Path) -> Path | None:
    """The recording of a result's run; None when there is none or another run has replaced it.

    Raises DataError when scene.json cannot be read.
    """
    folder = Path(folder)
    scene = read_json(folder / SCENE)
    named = scene.get("recording") if isinstance(scene, dict) else None
    if isinstance(named, dict) and isinstance(named.get("path"), str):
        try:
            found = folder.resolve() / named["path"]
            if found.is_file() and _digest(found) == named.get("sha256"):
                return Path(os.path.normpath(found))
        except (OSError, ValueError):  # unreadable, or no name of a file at all
            pass
    beside = folder / RECORDING
    return beside if beside.is_file() else None


def _relative(path: Path, folder: Path) -> str:
    """The path from the folder on, so that both can be moved together; absolute on another drive."""
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:
        return path.as_posix()


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        digest = hashlib.sha256()
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()
