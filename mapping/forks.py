"""A fork waits for threads that are over for Python and not yet for the system.

Knows threads by the system's numbers; knows nothing of what they worked on. A thread that has used MKL gives
its memory back on its way out, after Python has joined it, and holds MKL's locks meanwhile. A fork made then
inherits them locked for good: its first matrix product spins for ever (three of ten forks made right after a
join). Other threads that still work are the caller's to wait for.
"""

from __future__ import annotations

import os
import threading
import time

LONGEST_WAIT_S = 1.0
"""For one thread; its way out takes microseconds. A number given to another thread by now costs this much."""
MANY = 256
"""Numbers kept before those of threads long gone are dropped."""

_worked: set[int] = set()


def note_worker() -> None:
    """Let forks wait for the end of the thread that calls this."""
    _worked.add(threading.get_native_id())
    if len(_worked) > MANY:
        _worked.difference_update([one for one in tuple(_worked) if not _is_there(one)])


def _is_there(number: int) -> bool:
    return os.path.exists(f"/proc/self/task/{number}")  # nowhere but on Linux, where the fault is


def _wait_for_the_ending() -> None:
    going_on = {thread.native_id for thread in threading.enumerate()}
    for one in _worked - going_on:
        end = time.monotonic() + LONGEST_WAIT_S
        while _is_there(one) and time.monotonic() < end:
            time.sleep(1e-4)
        _worked.discard(one)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_wait_for_the_ending, after_in_child=_worked.clear)
