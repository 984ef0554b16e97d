"""Many frames in one process: a process costs seconds of imports for half a second of work."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

from mapping.errors import ConfigError, ContraMapError, DataError


def result_folders(frames: Sequence[Path], out: Path) -> list[Path]:
    """out/<name> of each frame; frames with the same name get their folder's name before it.

    Raises ConfigError when two frames would share a folder.
    """
    names = [_name(frame) for frame in frames]
    shared = {name for name, count in Counter(names).items() if count > 1}
    folders = [
        out / (f"{frame.resolve().parent.name}_{name}" if name in shared else name)
        for frame, name in zip(frames, names)
    ]
    twice = [folder for folder, count in Counter(folders).items() if count > 1]
    if twice:
        raise ConfigError(
            f"{len(frames)} frames, but more than one would go to {twice[0]}; map them apart, "
            "each with its --out"
        )
    return folders


def map_all(frames: Sequence[Path], folders: Sequence[Path], map_one: Callable[[Path, Path], None]) -> None:
    """Map one frame after another; a bad one is reported and the others go on.

    Raises DataError at the end when some could not be mapped.
    """
    from tqdm import tqdm

    failed = 0
    for frame, folder in tqdm(list(zip(frames, folders)), desc="frames", disable=None):
        try:
            map_one(frame, folder)
        except ContraMapError as error:
            failed += 1
            tqdm.write(f"{frame}: {' '.join(str(error).split())}")
        else:
            tqdm.write(f"result: {folder}")
    if failed:
        raise DataError(f"{failed} of {len(frames)} frames could not be mapped; the reasons are above")


def _name(frame: Path) -> str:
    frame = frame.resolve()
    return frame.name if frame.is_dir() else frame.stem
