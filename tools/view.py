"""`contramap view RESULT`: open a result in the rerun viewer, or say how to where there is no display."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Annotated

import tyro

from mapping.errors import ConfigError, DataError
from reconstruction.files.output_folder import RECORDING, SCENE


def view(result: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RESULT")]) -> None:
    """Open a result in the rerun viewer; without a display, say how to look at it elsewhere.

    Example: contramap view demo_out/result

    Args:
        result: Result folder or recording (.rrd); a run without a recording gets one made from its meshes.
    """
    recording = find_recording(Path(result))
    print(f"recording: {recording}")
    command = [*_viewer(), str(recording)]
    if not has_display():
        print("There is no display here. Copy the recording to a machine with one and run:")
        print(f"  rerun {shlex.quote(recording.name)}")
        print("or serve it from here to a web browser:")
        print(f"  {shlex.join([*command, '--serve-web'])}")
        return
    # The viewer outlives this command; its log would only clutter the terminal.
    subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)


def find_recording(result: Path) -> Path:
    """The recording of a result's run; else one of its meshes alone is made, beside them, or in a temporary
    folder if they are read-only."""
    if result.is_file() and result.suffix == ".rrd":
        return result
    from reconstruction.files.recordings import recording_of

    found = recording_of(result) if (result / SCENE).is_file() else None
    if found is not None:
        return found
    from reconstruction.files.stored import load_result
    from reconstruction.pictures.recording import record_stored

    stored = load_result(result)
    print("the run itself was not recorded, or its recording is gone; making one of the meshes")
    recording = result / RECORDING
    try:
        record_stored(stored, recording)
    except DataError:
        recording = Path(tempfile.mkdtemp(prefix="contramap_view_")) / RECORDING
        record_stored(stored, recording)
    return recording


def has_display() -> bool:
    """Whether a window can be opened here."""
    if sys.platform.startswith("linux"):
        return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    return True


def _viewer() -> list[str]:
    """The command of the viewer that belongs to this Python, on PATH or not."""
    from importlib.util import find_spec

    if find_spec("rerun") is None:
        raise ConfigError("the viewer needs rerun: pip install 'contramap[viz]'")
    return [sys.executable, "-m", "rerun"]
