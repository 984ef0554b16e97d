"""Where jobs run: worker processes of this machine, or a Ray cluster. Same jobs, same numbers.

Every job seeds itself and fixes its thread count, so neither the engine nor the order has an influence.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import replace

from mapping.errors import ConfigError
from tools.evaluation.job import Job, run_job

CRASHED = "the worker process died (out of memory, or a crash in a library)"

Failures = list[dict[str, str]]
Finished = Callable[[Job, Failures], None]
"""Called with each job when it is over and what failed in it."""


def worker_environment(threads: int) -> dict[str, str]:
    """Thread counts that numerical libraries read when they are first imported."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    return {**dict.fromkeys(names, str(threads)), "OMP_WAIT_POLICY": "PASSIVE"}


def run_local(jobs: Sequence[Job], workers: int, finished: Finished) -> None:
    """Run jobs in `workers` processes of their own, so that a crash costs one job and not the evaluation."""
    waiting = list(jobs)
    with process_environment(worker_environment(jobs[0].threads if jobs else 1)):
        while waiting:
            waiting = _pool(waiting, workers, finished)


def _pool(jobs: list[Job], workers: int, finished: Finished) -> list[Job]:
    """Run jobs until a worker dies or all are done; returns the jobs still to do."""
    context = multiprocessing.get_context("spawn")
    left = list(jobs)
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        running: dict[Future[Failures], Job] = {}
        try:
            # One job a worker at a time, so that a dead worker is blamed on the jobs that really ran.
            while left or running:
                while left and len(running) < workers:
                    job = left.pop(0)
                    running[pool.submit(run_job, job)] = job
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    job = running[future]
                    failures = future.result()
                    del running[future]
                    finished(job, failures)
        except BrokenProcessPool:
            for job in running.values():
                crashed = job.missing()[:1]
                finished(job, [job.failure(run, CRASHED) for run in crashed])
                rest = replace(job, given_up=job.given_up | set(crashed))
                left.extend([rest] if rest.missing() else [])
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return left


def run_ray(jobs: Sequence[Job], workers: int, finished: Finished, address: str | None = None) -> None:
    """Run jobs on a Ray cluster: the one at `address`, or a local one of `workers` workers.

    Scenes and results must lie where every node can reach them. Raises ConfigError without ray.
    """
    try:
        import ray
    except ImportError as error:
        raise ConfigError("--engine ray needs ray: pip install 'contramap[cluster]'") from error
    threads = jobs[0].threads if jobs else 1
    started = not ray.is_initialized()
    if started:
        local = {"num_cpus": workers, "include_dashboard": False} if address is None else {"address": address}
        ray.init(**local, log_to_driver=False, logging_level=logging.ERROR)
    try:
        environment = {"env_vars": worker_environment(threads)}
        remote = ray.remote(num_cpus=1, max_retries=0, runtime_env=environment)(run_job)
        running = {remote.remote(job): job for job in jobs}
        while running:
            (reference,), _ = ray.wait(list(running), num_returns=1)
            job = running.pop(reference)
            try:
                failures = ray.get(reference)
            except ray.exceptions.RayError as error:
                failures = [job.failure(run, f"{error}".splitlines()[0] or CRASHED) for run in job.missing()]
            finished(job, failures)
    finally:
        if started:
            ray.shutdown()


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
