"""Small pieces of torch work on all cores: one piece a thread, one core a piece.

Splitting each small operation over cores costs more in waiting than it wins; splitting the pieces does not.
It also keeps OpenMP's own threads asleep: they spin between operations, and where another process wants
the cores that costs tens of times what they win.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable
from itertools import pairwise
from queue import SimpleQueue
from typing import TypeVar

import torch
from typing_extensions import Self

from mapping.forks import note_worker

Item = TypeVar("Item")
Result = TypeVar("Result")


LEAST_PIECES = 2
"""Work whose sums depend on how it is split is split in two even for one thread, so that one thread and two
give the same bytes."""

_of_parent: int | None = None
"""In a process made by fork: how many threads torch had in the one it was made from."""


class _Shared:
    """What callers on several Python threads share: torch's count is set to one while any of them works, and
    who asks torch then would take that for the truth, and split sums otherwise."""

    def __init__(self) -> None:
        self.lock, self.open, self.count = threading.Lock(), 0, 1


_shared = _Shared()
_inside = threading.local()
"""On threads that have a share of the work already: what they split again stays with them."""


def _after_fork() -> None:
    # OpenMP's threads do not survive a fork, and the first work given to them would wait for ever: torch
    # itself works on one core from here on. Threads of our own are started anew, so results stay the same.
    global _of_parent, _shared, _inside
    _of_parent = _whole_count()
    _shared, _inside = _Shared(), threading.local()
    torch.set_num_threads(1)


def thread_count() -> int:
    """How many threads share the work: as many as torch has, or had before this process was forked."""
    return 1 if getattr(_inside, "work", False) else _whole_count()


def _whole_count() -> int:
    if _of_parent is not None:
        return _of_parent
    count = torch.get_num_threads()
    return _shared.count if _shared.open else count


def _one_core() -> None:
    """Let torch work on one core where this is called from."""
    # A new thread takes the count that was set last, by whichever thread, when it is first asked for: ask, so
    # that it is not taken later, in the middle of the work.
    torch.get_num_threads()
    torch.set_num_threads(1)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


class Threads:
    """As many threads as torch may use, each on one core; torch itself uses one while this is open.

    device: where the work is done; anything but a CPU is driven by one thread.
    """

    def __init__(self, device: torch.device | None = None) -> None:
        on_cpu = device is None or device.type == "cpu"
        self.count = thread_count() if on_cpu else 1
        self.pieces = max(self.count, LEAST_PIECES)
        self._work: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._workers: list[threading.Thread] = []

    def __enter__(self) -> Self:
        note_worker()
        if self.count > 1:
            with _shared.lock:
                if _shared.open == 0:
                    _shared.count = self.count
                _shared.open += 1
            for _ in range(self.count - 1):
                worker = threading.Thread(target=self._serve, daemon=True)
                worker.start()
                self._workers.append(worker)
            _one_core()
            _inside.work = True
        return self

    def __exit__(self, *exception: object) -> None:
        for _ in self._workers:
            self._work.put(None)
        for worker in self._workers:
            worker.join()
        if self._workers:
            _inside.work = False
            # In a fork torch itself stays on one core.
            torch.set_num_threads(self.count if _of_parent is None else 1)
            with _shared.lock:
                _shared.open -= 1
        self._workers.clear()

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
        """[function(item) for item in items]; the order, so the result, is kept."""
        if not self._workers:
            return [function(item) for item in items]
        queue = iter(list(enumerate(items)))  # next() of a list's iterator is atomic
        finished: SimpleQueue[dict[int, Result] | BaseException] = SimpleQueue()

        def work() -> None:
            try:
                finished.put({index: function(item) for index, item in queue})
            except BaseException as error:
                finished.put(error)

        # Two plain queues hand work over in a sixth of the time of an executor and its futures.
        for _ in self._workers:
            self._work.put(work)
        work()
        done: dict[int, Result] = {}
        for part in [finished.get() for _ in range(self.count)]:
            if isinstance(part, BaseException):
                raise part
            done.update(part)
        return [done[index] for index in range(len(done))]

    def split(self, total: int) -> list[slice]:
        """0..total in `pieces` of about the same size, none of them empty."""
        ends = [total * k // self.pieces for k in range(self.pieces + 1)]
        return [slice(a, b) for a, b in pairwise(ends) if b > a]

    def _serve(self) -> None:
        # Every thread must be told: MKL keeps its count thread by thread, and its sums, to the last bit,
        # depend on it.
        note_worker()
        _one_core()
        _inside.work = True
        while (work := self._work.get()) is not None:
            work()


def map_in_threads(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """[function(item) for item in items] on torch's number of threads; the order, so the result, is kept."""
    with Threads() as threads:
        return threads.map(function, items)
