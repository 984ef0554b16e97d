"""Folders that are either complete or absent, and replaced in one step or not at all.

A folder is built under a hidden name beside its place and renamed. An older one is exchanged for it by a
single call of the system, so that there is no moment without either. Knows folders only.
"""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from mapping.errors import ConfigError, DataError
from mapping.files import advice, is_temporary, remove_left_over, temporary_name
from mapping.locks import claim, locked, release

AT_FDCWD, RENAME_EXCHANGE = -100, 2
"""Of Linux's renameat2."""


@contextmanager
def staged_folder(
    folder: Path, may_replace: Callable[[], object] | None = None, last: str | None = None
) -> Iterator[Path]:
    """A new hidden folder to fill; at the end it takes the place of `folder`, on any error it is removed.

    folder: absent or empty, unless may_replace is given, which raises when what is there may not go. It is
    asked while no other run can come between. last: the file that makes the folder complete; it is moved last
    where a folder cannot be renamed as a whole (mount points, parents that cannot be written).
    Raises ConfigError when another run has filled `folder` meanwhile, DataError when it cannot be written.
    """
    within = not can_be_renamed(folder)
    place = folder if within else folder.parent
    partial, lock = temporary_name(folder), None
    partial = place / partial.name
    try:
        try:
            place.mkdir(parents=True, exist_ok=True)
            remove_left_over(folder, place)
            lock = claim(partial, Path.mkdir)
            yield partial
            with locked(place):
                if may_replace is not None:
                    may_replace()
                elif folder.exists() and any(not is_temporary(entry) for entry in folder.iterdir()):
                    raise ConfigError(
                        f"{folder} was filled by another run meanwhile and is kept; choose another folder"
                    )
                (_move_in if within else _rename)(partial, folder, last)
        except OSError as error:
            raise DataError(f"cannot write {folder}: {error.strerror or error}{advice(error)}") from error
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    finally:
        release(lock)


@contextmanager
def temporary_folder(path: Path) -> Iterator[Path]:
    """A new hidden folder beside `path` for what is under way; removed at the end, and after a kill by the
    next one of the same `path`. Raises DataError when it cannot be made."""
    partial, lock = temporary_name(path), None
    try:
        remove_left_over(path)
        try:
            lock = claim(partial, Path.mkdir)
        except OSError as error:
            raise DataError(
                f"cannot write {path.parent}: {error.strerror or error}{advice(error)}"
            ) from error
        yield partial
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        release(lock)


def scratch_folder(kind: str) -> AbstractContextManager[Path]:
    """A temporary folder of the system's, for files that other programs read; what a killed run left of the
    same kind is removed."""
    return temporary_folder(Path(tempfile.gettempdir()) / f"contramap_{kind}")


def can_be_renamed(folder: Path) -> bool:
    """Whether a folder can be put in its place as a whole: no mount point, and its parent is writable."""
    if os.path.ismount(folder):
        return False
    return not folder.is_dir() or os.access(folder.parent, os.W_OK | os.X_OK)


def check_writable(folder: Path) -> None:
    """Raise DataError when a folder that may not exist yet could not be made or filled; makes nothing."""
    nearest = folder
    while not os.path.lexists(nearest) and nearest != nearest.parent:
        nearest = nearest.parent
    if not nearest.is_dir():
        raise ConfigError(f"{folder} cannot be made: {nearest} is not a folder")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise DataError(
            f"cannot write {folder}: {nearest} is read-only; choose a folder that you may write to"
        )


def _rename(partial: Path, folder: Path, last: str | None) -> None:
    if not folder.exists() or not any(folder.iterdir()):
        os.rename(partial, folder)  # an empty folder gives way
        return
    if exchange(partial, folder):
        return  # what was there has the hidden name now, and is removed with it
    old = temporary_name(folder, "old")
    os.rename(folder, old)
    try:
        os.rename(partial, folder)
    except OSError:
        os.rename(old, folder)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _move_in(partial: Path, folder: Path, last: str | None) -> None:
    """Entry by entry: without the file that makes it complete, a folder is no result."""
    old = folder / temporary_name(folder, "old").name
    old.mkdir()
    entries = sorted(folder.iterdir(), key=lambda entry: entry.name != last)
    for entry in [entry for entry in entries if not is_temporary(entry)]:
        os.rename(entry, old / entry.name)
    for entry in sorted(partial.iterdir(), key=lambda entry: entry.name == last):
        os.rename(entry, folder / entry.name)
    shutil.rmtree(old, ignore_errors=True)


def exchange(a: Path, b: Path) -> bool:
    """Exchange the names of two files or folders in one step; False where the system cannot."""
    if not sys.platform.startswith("linux"):
        return False
    try:
        call = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError):
        return False
    done = call(AT_FDCWD, os.fsencode(a), AT_FDCWD, os.fsencode(b), RENAME_EXCHANGE)
    if done == 0:
        return True
    code = ctypes.get_errno()
    if code in (errno.ENOSYS, errno.EINVAL, errno.EPERM, errno.EOPNOTSUPP):
        return False
    raise OSError(code, os.strerror(code))
