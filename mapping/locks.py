"""Who is at work on a file or folder: a lock the system takes back when its owner ends, however it ends.

Knows paths only. Where there are no such locks (Windows, some network disks), nobody ever seems to work.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


PATIENCE_S = 30.0
"""Seconds to wait for a lock; longer than any rename takes."""


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder; waits a while for others that hold it. No file is made for it."""
    end = time.monotonic() + PATIENCE_S
    while (lock := hold(folder)) is None and fcntl is not None and time.monotonic() < end:
        time.sleep(0.02)
    try:
        yield
    finally:
        release(lock)


def claim(path: Path, make: Callable[[Path], object]) -> int | None:
    """Make a file or folder and take its lock, before anybody can think that its owner has gone."""
    while True:
        make(path)
        lock = hold(path, wait=True)
        if lock is None:
            return None
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(lock), os.stat(path)):
                return lock
        release(lock)  # taken for a left-over and removed in between


def hold(path: Path, wait: bool = False) -> int | None:
    """Take the lock of a file or folder that is there; None when another process has it or there are none."""
    if fcntl is None:
        return None
    try:
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_CLOEXEC", 0))
    except OSError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        return None
    return descriptor


def release(lock: int | None) -> None:
    """Give a lock back."""
    if lock is not None:
        os.close(lock)
