"""Small pieces of torch work on all cores: one piece a thread, one core a piece.

Splitting each small operation over cores costs more in waiting than it wins; splitting the pieces does not.
It also keeps OpenMP's own threads asleep: they spin between operations, and where another process wants
the cores that costs tens of times what they win.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import TypeVar

import torch
from typing_extensions import Self

Item = TypeVar("Item")
Result = TypeVar("Result")


class Threads:
    """As many threads as torch may use, each on one core; torch itself uses one while this is open.

    device: where the work is done; anything but a CPU is driven by one thread.
    """

    def __init__(self, device: torch.device | None = None) -> None:
        on_cpu = device is None or device.type == "cpu"
        self.count = torch.get_num_threads() if on_cpu else 1
        self._pool: ThreadPoolExecutor | None = None

    def __enter__(self) -> Self:
        if self.count > 1:
            # Every thread must be told: MKL keeps its count thread by thread, and its sums, to the last bit,
            # depend on it.
            one = (1,)
            self._pool = ThreadPoolExecutor(self.count - 1, initializer=torch.set_num_threads, initargs=one)
            torch.set_num_threads(1)
        return self

    def __exit__(self, *exception: object) -> None:
        if self._pool is not None:
            self._pool.shutdown()
            torch.set_num_threads(self.count)

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
        """[function(item) for item in items]; the order, so the result, is kept."""
        if self._pool is None:
            return [function(item) for item in items]
        queue = iter(list(enumerate(items)))  # next() of a list's iterator is atomic

        def work() -> list[tuple[int, Result]]:
            return [(index, function(item)) for index, item in queue]

        others = [self._pool.submit(work) for _ in range(self.count - 1)]
        done = work()
        for other in others:
            done.extend(other.result())
        return [result for _, result in sorted(done, key=lambda pair: pair[0])]

    def split(self, total: int) -> list[slice]:
        """0..total in one piece a thread, none of them empty."""
        ends = [total * k // self.count for k in range(self.count + 1)]
        return [slice(a, b) for a, b in pairwise(ends) if b > a]


def map_in_threads(function: Callable[[Item], Result], items: Iterable[Item]) -> list[Result]:
    """[function(item) for item in items] on torch's number of threads; the order, so the result, is kept."""
    with Threads() as threads:
        return threads.map(function, items)
