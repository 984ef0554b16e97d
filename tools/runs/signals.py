"""Signals that ask a command to end: it cleans up, and says so, instead of vanishing."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

NAMES = ("SIGTERM", "SIGHUP")


class Stopped(BaseException):
    """A signal asked this process to end. number: which."""

    def __init__(self, number: int) -> None:
        super().__init__(f"ended by {signal.Signals(number).name}; what is finished is kept")
        self.number = number


@contextmanager
def handlers_kept() -> Iterator[None]:
    """Handlers that a library sets inside are undone, and a SIGTERM that reached one of them reaches ours.

    Ray's raises SystemExit.
    """
    known = [getattr(signal, name) for name in NAMES if hasattr(signal, name)]
    before = {number: signal.getsignal(number) for number in known}
    asked = None
    try:
        yield
    except SystemExit as error:
        asked = error
    finally:
        if threading.current_thread() is threading.main_thread():
            for number, handler in before.items():
                if handler is not None:  # None: set by other code than Python's, which cannot be put back
                    signal.signal(number, handler)
    if asked is not None:
        if callable(ours := before[signal.SIGTERM]):
            ours(signal.SIGTERM, None)
        raise asked


@contextmanager
def stopped_by_signals() -> Iterator[None]:
    """SIGTERM and SIGHUP raise Stopped inside, once, so that `finally` clauses run.

    It leaves as Stopped, whatever error a library makes of it on the way. Signals that are ignored (nohup) or
    handled otherwise stay so.
    """
    known = [getattr(signal, name) for name in NAMES if hasattr(signal, name)]
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    ours = [number for number in known if signal.getsignal(number) is signal.SIG_DFL]
    asked: list[int] = []

    def stop(number: int, frame: Any) -> None:
        for each in ours:
            signal.signal(each, signal.SIG_IGN)  # a second one must not cut the clean-up short
        asked.append(number)
        raise Stopped(number)

    for number in ours:
        signal.signal(number, stop)
    try:
        yield
    except Exception as error:
        if asked:
            raise Stopped(asked[0]) from error
        raise
    finally:
        for number in ours:
            signal.signal(number, signal.SIG_DFL)
