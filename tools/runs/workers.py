"""Worker processes: one task at a time each, and none outlives the process that started it.

Knows functions and their tasks; knows nothing of what they compute or where results are kept.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from multiprocessing.reduction import ForkingPickler
from typing import Any, Generic, TypeVar

from mapping.errors import DataError
from mapping.parent import end_with_parent

Task = TypeVar("Task")
Result = TypeVar("Result")

CRASHED = "the worker process died (out of memory, or a crash in a library)"
END_S = 5.0
"""Seconds that a worker without work is given to end by itself."""


@dataclass(frozen=True)
class Done(Generic[Task, Result]):
    """A task that is over. result: what the function returned; error: what it raised, or None;
    died: the worker ended in the middle of it, and there is neither."""

    task: Task
    result: Result | None = None
    error: Exception | None = None
    died: bool = False


@dataclass
class _Worker:
    process: BaseProcess
    connection: Connection
    task: Any = None


def worker_environment(threads: int) -> dict[str, str]:
    """Thread counts that numerical libraries read when they are first imported."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    return {**dict.fromkeys(names, str(threads)), "OMP_WAIT_POLICY": "PASSIVE"}


def run_in_workers(
    function: Callable[[Task], Result], tasks: Iterable[Task], workers: int, threads: int = 1
) -> Iterator[Done[Task, Result]]:
    """Run function(task) for all tasks in fresh processes of `threads` threads each, as they are done.

    A worker that dies costs the task it had and no other; another takes its place. All workers end with the
    iterator, whatever ends it, and with this process, even when that is killed.
    """
    # Fresh processes: a fork of one that has used torch's threads can hang.
    context = multiprocessing.get_context("spawn")
    waiting = iter(tasks)
    pool: list[_Worker] = []
    try:
        exhausted = False
        while True:
            while not exhausted and sum(worker.task is not None for worker in pool) < max(workers, 1):
                try:
                    task = next(waiting)
                except StopIteration:
                    exhausted = True
                    break
                worker = next((w for w in pool if w.task is None), None) or _start(
                    context, function, threads, pool
                )
                # One that died while it had nothing to do costs no task.
                while not _send(worker, task):
                    _remove(worker, pool)
                    worker = _start(context, function, threads, pool)
                worker.task = (task,)
            busy = [worker for worker in pool if worker.task is not None]
            if not busy:
                return
            yield from _finished(busy, pool)
    finally:
        for worker in pool:
            worker.connection.close()
            if worker.task is not None:
                worker.process.kill()
        for worker in pool:
            worker.process.join(END_S)
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join()


def map_in_workers(
    function: Callable[[Task], Result], tasks: Iterable[Task], workers: int, threads: int = 1
) -> Iterator[Result]:
    """function(task) of all tasks, in their order, from worker processes; a task whose worker dies is tried
    once more. Raises what a task raises, and DataError when a worker dies again."""
    numbered = list(enumerate(tasks))
    made: dict[int, Result] = {}
    following = 0
    for _ in range(2):
        died = []
        for over in run_in_workers(_Numbered(function), numbered, workers, threads):
            if over.error is not None:
                raise over.error
            if over.died:
                died.append(over.task)
                continue
            assert over.result is not None
            made[over.task[0]] = over.result[0]
            while following in made:
                yield made.pop(following)
                following += 1
        if not died:
            return
        numbered = died
    raise DataError(f"{len(died)} of the tasks: {CRASHED}, twice; use fewer --workers")


@dataclass(frozen=True)
class _Numbered:
    """A function of a task, for a task with its number; the result in a tuple, since it may be None."""

    function: Callable[[Any], Any]

    def __call__(self, task: tuple[int, Any]) -> tuple[Any]:
        return (self.function(task[1]),)


def _finished(busy: list[_Worker], pool: list[_Worker]) -> Iterator[Done]:
    ready = wait([worker.connection for worker in busy] + [worker.process.sentinel for worker in busy])
    for worker in busy:
        if worker.connection not in ready and worker.process.sentinel not in ready:
            continue
        (task,) = worker.task
        answer = None
        with suppress(EOFError, OSError):
            if worker.connection.poll():
                answer = worker.connection.recv()
        if answer is None:
            _remove(worker, pool)
            yield Done(task, died=True)
        else:
            worker.task = None
            yield Done(task, *answer)


def _start(context: Any, function: Callable, threads: int, pool: list[_Worker]) -> _Worker:
    ours, theirs = context.Pipe()
    with process_environment(worker_environment(threads)):
        # As bytes: the seconds that a function's imports take come after the worker is bound to its parent.
        content = bytes(ForkingPickler.dumps(function))
        process = context.Process(target=_serve, args=(content, theirs, os.getpid()), daemon=True)
        process.start()
    theirs.close()
    pool.append(_Worker(process, ours))
    return pool[-1]


def _send(worker: _Worker, task: Any) -> bool:
    try:
        worker.connection.send(task)
    except (BrokenPipeError, ConnectionError):
        return False
    return True


def _remove(worker: _Worker, pool: list[_Worker]) -> None:
    pool.remove(worker)
    worker.connection.close()
    worker.process.kill()
    worker.process.join()


def _serve(content: bytes, connection: Connection, parent: int) -> None:
    """Runs in the worker: tasks in, answers out, until there are no more."""
    end_with_parent(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all; the parent says what to do
    function = pickle.loads(content)
    while True:
        try:
            task = connection.recv()
        except EOFError:
            return
        try:
            answer: tuple[Any, Exception | None] = function(task), None
        except Exception as error:
            answer = None, error
        try:
            connection.send(answer)
        except (BrokenPipeError, ConnectionError):
            return
        except Exception as error:  # what cannot be pickled
            connection.send((None, RuntimeError(f"{type(error).__name__}: {error}; {answer[1]!r}")))


@contextmanager
def process_environment(values: dict[str, str]) -> Iterator[None]:
    """Environment variables for the processes started inside."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name)
            else:
                os.environ[name] = value
