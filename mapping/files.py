"""Files that are either complete or absent: written under a temporary name, then renamed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

from mapping.errors import DataError


@contextmanager
def temporary_beside(path: Path) -> Iterator[Path]:
    """A new path beside `path` to write to; renamed to `path` at the end, removed on any error.

    Raises DataError when the disk is full or the folder cannot be written.
    """
    partial = path.with_name(f".{path.name[:80]}.{uuid4().hex[:12]}.part")
    try:
        yield partial
        os.replace(partial, path)
    except OSError as error:
        raise DataError(f"cannot write {path}: {error.strerror or error}{advice(error)}") from error
    finally:
        partial.unlink(missing_ok=True)


def write_atomically(path: Path, content: bytes) -> None:
    """Write a whole file, or leave what was there."""
    with temporary_beside(path) as partial:
        partial.write_bytes(content)


def advice(error: OSError) -> str:
    """How to mend an error while writing, as the end of a message."""
    import errno

    hints = {
        errno.ENOSPC: "; free some space or choose another output folder",
        errno.EDQUOT: "; the disk quota is used up, choose another output folder",
        errno.EFBIG: "; the file size limit is reached, choose another output folder",
        errno.EACCES: "; choose a folder that you may write to",
        errno.EROFS: "; choose a folder that you may write to",
        errno.ENOENT: "; does its folder exist?",
    }
    return hints.get(error.errno or 0, "")
