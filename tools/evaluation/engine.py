"""Where jobs run: worker processes of this machine, or a Ray cluster. Same jobs, same numbers.

Every job seeds itself and fixes its thread count, so neither the engine nor the order has an influence.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from tools.evaluation.job import Job, run_job
from tools.runs.ray_cluster import ray_cluster
from tools.runs.workers import CRASHED, run_in_workers, worker_environment

Failures = list[dict[str, str]]
Finished = Callable[[Job, Failures], None]
"""Called with each job when it is over and what failed in it."""


def run_local(jobs: Sequence[Job], workers: int, finished: Finished) -> None:
    """Run jobs in `workers` processes of their own, so that a crash costs one run and not the evaluation."""
    waiting = list(jobs)
    threads = jobs[0].threads if jobs else 1
    while waiting:
        again: list[Job] = []
        for done in run_in_workers(run_job, waiting, workers, threads):
            if not done.died:
                failures = done.result if done.error is None else _all_failed(done.task, done.error)
                finished(done.task, failures or [])
                continue
            # Results are kept run by run: the first that is missing is the one the worker died of.
            crashed = done.task.missing()[:1]
            rest = replace(done.task, given_up=done.task.given_up | set(crashed))
            finished(done.task, [done.task.failure(run, CRASHED) for run in crashed])
            again += [rest] if rest.missing() else []
        waiting = again


def _all_failed(job: Job, error: Exception) -> Failures:
    return [job.failure(run, f"{type(error).__name__}: {error}") for run in job.missing()]


def run_ray(jobs: Sequence[Job], workers: int, finished: Finished, address: str | None = None) -> None:
    """Run jobs on a Ray cluster: the one at `address`, or a local one of `workers` workers.

    Scenes and results must lie where every node can reach them. Raises ConfigError without ray.
    """
    if not jobs:
        return  # a cluster takes seconds to start
    threads = jobs[0].threads
    with ray_cluster(workers, address) as ray:
        environment = {"env_vars": worker_environment(threads)}
        remote = ray.remote(num_cpus=1, max_retries=0, runtime_env=environment)(run_job)
        running = {remote.remote(job): job for job in jobs}
        while running:
            (reference,), _ = ray.wait(list(running), num_returns=1)
            job = running.pop(reference)
            try:
                failures = ray.get(reference)
            except ray.exceptions.WorkerCrashedError:
                crashed = job.missing()[:1]
                failures = [job.failure(run, CRASHED) for run in crashed]
                rest = replace(job, given_up=job.given_up | set(crashed))
                if rest.missing():
                    running[remote.remote(rest)] = rest
            except ray.exceptions.RayError as error:
                failures = [job.failure(run, f"{error}".splitlines()[0] or CRASHED) for run in job.missing()]
            finished(job, failures)
