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

Item = TypeVar("Item")
Result = TypeVar("Result")


_of_parent: int | None = None
"""In a process made by fork: how many threads torch had in the one it was made from."""


def _after_fork() -> None:
    # OpenMP's threads do not survive a fork, and the first work given to them would wait for ever: torch
    # itself works on one core from here on. Threads of our own are started anew, so results stay the same.
    global _of_parent
    _of_parent = thread_count()
    torch.set_num_threads(1)


def thread_count() -> int:
    """How many threads share the work: as many as torch has, or had before this process was forked."""
    return torch.get_num_threads() if _of_parent is None else _of_parent


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


class Threads:
    """As many threads as torch may use, each on one core; torch itself uses one while this is open.

    device: where the work is done; anything but a CPU is driven by one thread.
    """

    def __init__(self, device: torch.device | None = None) -> None:
        on_cpu = device is None or device.type == "cpu"
        self.count = thread_count() if on_cpu else 1
        self._before = torch.get_num_threads()
        self._work: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._workers: list[threading.Thread] = []

    def __enter__(self) -> Self:
        if self.count > 1:
            for _ in range(self.count - 1):
                worker = threading.Thread(target=self._serve, daemon=True)
                worker.start()
                self._workers.append(worker)
            torch.set_num_threads(1)
        return self

    def __exit__(self, *exception: object) -> None:
        for _ in self._workers:
            self._work.put(None)
        for worker in self._workers:
            worker.join()
        if self._workers:
            torch.set_num_threads(self._before)
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
        """0..total in one piece a thread, none of them empty."""
        ends = [total * k // self.count for k in range(self.count + 1)]
        return [slice(a, b) for a, b in pairwise(ends) if b > a]

    def _serve(self) -> None:
        # Every thread must be told: MKL keeps its count thread by thread, and its sums, to the last bit,
        # depend on it.
        torch.set_num_threads(1)
        while (work := self._work.get()) is not None:
            work()


def map_in_threads(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """[function(item) for item in items] on torch's number of threads; the order, so the result, is kept."""
    with Threads() as threads:
        return threads.map(function, items)
