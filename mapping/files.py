"""Files that are either complete or absent: written under a temporary name, then renamed; and the cache.

What a process that was killed has left is removed when the same file is written again.
"""

from __future__ import annotations

import errno
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from uuid import uuid4

from mapping.errors import DataError
from mapping.locks import claim, hold, release

LEFT_OVER = r"\.{name}\.[0-9a-f]{{12}}\.(part|old)"
"""What temporary names look like."""


@contextmanager
def temporary_beside(path: Path) -> Iterator[Path]:
    """A new empty file beside `path` to write to; renamed to `path` at the end, removed on any error.

    Raises DataError when the disk is full or the folder cannot be written.
    """
    partial = temporary_name(path)
    lock = None
    try:
        try:
            remove_left_over(path)
            lock = claim(partial, Path.touch)
            yield partial
            os.replace(partial, path)
        except OSError as error:
            raise DataError(f"cannot write {path}: {error.strerror or error}{advice(error)}") from error
        finally:
            with suppress(OSError):  # on a disk that became read-only; the error above says so
                partial.unlink(missing_ok=True)
    finally:
        release(lock)


def temporary_name(path: Path, kind: str = "part") -> Path:
    """A hidden name beside a file or folder that nothing has yet."""
    return path.with_name(f".{path.name[:80]}.{uuid4().hex[:12]}.{kind}")


def is_temporary(path: Path) -> bool:
    """Whether a file or folder is unfinished, or left over from a process that was killed."""
    return re.fullmatch(LEFT_OVER.format(name=".*"), path.name) is not None


def remove_left_over(path: Path, within: Path | None = None) -> None:
    """Remove what killed processes have left of a file or folder; whoever is still at work holds a lock.

    within: the folder to look in; by default the one that `path` lies in.
    """
    pattern = re.compile(LEFT_OVER.format(name=re.escape(path.name[:80])))
    folder = path.parent if within is None else within
    with suppress(OSError):
        for found in [entry for entry in folder.iterdir() if pattern.fullmatch(entry.name)]:
            lock = hold(found)
            if lock is None:
                continue
            if found.is_dir() and not found.is_symlink():
                shutil.rmtree(found, ignore_errors=True)
            else:
                found.unlink(missing_ok=True)
            release(lock)


def cache_dir() -> Path:
    """The folder for what is worth keeping between runs: $CONTRAMAP_CACHE, or ~/.cache/contramap."""
    override = os.environ.get("CONTRAMAP_CACHE")
    return Path(override).expanduser() if override else Path.home() / ".cache" / "contramap"


def write_atomically(path: Path, content: bytes) -> None:
    """Write a whole file, or leave what was there."""
    with temporary_beside(path) as partial:
        partial.write_bytes(content)


def advice(error: OSError) -> str:
    """How to mend an error while writing, as the end of a message."""
    hints = {
        errno.ENOSPC: "; free some space or choose another output folder",
        errno.EDQUOT: "; the disk quota is used up, choose another output folder",
        errno.EFBIG: "; the file size limit is reached, choose another output folder",
        errno.EACCES: "; choose a folder that you may write to",
        errno.EPERM: "; choose a folder that you may write to",
        errno.EROFS: "; choose a folder that you may write to",
        errno.ENOENT: "; does its folder exist?",
        errno.ENAMETOOLONG: "; choose a shorter name",
    }
    return hints.get(error.errno or 0, "")
