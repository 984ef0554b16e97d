"""Processes that end when the one that started them does, however it ends."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
import time

PR_SET_PDEATHSIG = 1
"""Of Linux's prctl."""
LOOK_S = 1.0
"""Seconds between looks where the system does not tell."""


def end_with_parent(parent: int) -> None:
    """Let this process be killed when process `parent` (its id), which started it, ends."""
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    threading.Thread(target=_watch, args=(parent,), daemon=True).start()


def _watch(parent: int) -> None:
    # Also for a parent that had ended before the system was asked to tell.
    while os.getppid() == parent:
        time.sleep(LOOK_S)
    os._exit(1)
