"""Frames of one scene in the order in which they were taken: a folder of frames.

Knows names of files and how one frame is loaded; knows nothing of maps. A frame is read when it is its turn.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from mapping.errors import ConfigError
from perception.frame import Frame
from perception.frame_io import load_frame

FILES = (".npz", ".pcd", ".ply")
"""Frames that are one file each."""
CAMERA = "camera.json"
"""What makes a folder a frame, whose further views lie in ..."""
VIEWS = "views"
"""... this folder, as simulated scenes and result folders have them."""


@dataclass(frozen=True)
class Shot:
    """One frame to come. name: to tell it from the others; load: reads it, raising FrameError; stamp: when it
    was taken [s], None where that is unknown."""

    name: str
    load: Callable[[], Frame]
    stamp: float | None = None


def shots_in(folder: Path, depth_scale: float | None = None, trust: Sequence[str] = ()) -> list[Shot]:
    """The frames below a folder by name, numbers as numbers: its folders and .npz, .pcd and .ply files. Where
    it is a frame itself, that comes first and those in its views/ follow.

    Raises ConfigError when there is none.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder; give a folder with one frame folder or .npz a frame")
    if (folder / CAMERA).is_file():
        further = folder / VIEWS
        paths = [folder, *(_frames_below(further) if further.is_dir() else ())]
    else:
        paths = _frames_below(folder)
    if not paths:
        raise ConfigError(f"{folder}: holds no frame; give a folder with one frame folder or .npz a frame")

    def shot(path: Path) -> Shot:
        name = folder.name if path == folder else path.relative_to(folder).as_posix()
        return Shot(name, lambda: load_frame(path, depth_scale=depth_scale, trust=trust))

    return [shot(path) for path in paths]


def _frames_below(folder: Path) -> list[Path]:
    found = [
        path
        for path in folder.iterdir()
        if not path.name.startswith(".") and (path.is_dir() or path.suffix.lower() in FILES)
    ]
    return sorted(found, key=lambda path: natural(path.name))


def natural(name: str) -> tuple[tuple[int, int | str], ...]:
    """A key by which frame_2 comes before frame_10."""
    words = re.findall(r"\d+|\D+", name)
    return tuple((0, int(word)) if word.isdigit() else (1, word) for word in words)
