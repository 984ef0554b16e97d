"""Tasks on this machine's processes or on a Ray cluster; a worker that dies costs a retry, not the run.

Knows tasks of a job and a tile, and their order; must not know what they do.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

from mapping.errors import DataError
from mapping.threads import thread_count
from tools.runs.ray_cluster import ray_cluster
from tools.runs.workers import run_in_workers
from tools.semantic.tiles import Job, Tile, fit_tile, write_tile

Task = Callable[[Job, Tile], None]
RETRIES = 3
"""Times that a task is tried again after its worker died."""


def make_tiles(
    job: Job, workers: int, engine: str, wrap: Callable[[Task], Task] = lambda task: task
) -> dict[str, float]:
    """Fit every tile's map, then write its voxels, what is done already left out: seconds of both.

    wrap: what is made of a task before it is run.
    """
    from tqdm import tqdm

    tiles, seconds = list(job.plan.tiles()), {}
    for task, name in ((fit_tile, "fit"), (write_tile, "voxels")):
        start = time.perf_counter()
        with tqdm(total=len(tiles), desc=f"tiles: {name}", disable=None) as bar:
            run_tasks(wrap(task), job, tiles, workers, engine, bar.update)
        seconds[f"{name}_s"] = time.perf_counter() - start
    return seconds


def run_tasks(
    task: Task, job: Job, tiles: list[Tile], workers: int, engine: str, done: Callable[[], object]
) -> None:
    """Run a task for every tile; `done` is called after each. Raises DataError when workers keep dying."""
    if engine == "ray":
        _on_ray(task, job, tiles, workers, done)
    elif workers == 1:
        for tile in tiles:
            task(job, tile)
            done()
    else:
        _in_processes(task, job, tiles, workers, done)


def _in_processes(task: Task, job: Job, tiles: list[Tile], workers: int, done: Callable[[], object]) -> None:
    left = list(tiles)
    for _ in range(RETRIES + 1):
        died: list[Tile] = []
        for over in run_in_workers(partial(task, job), left, workers, thread_count()):
            if over.error is not None:
                raise over.error
            if over.died:
                died.append(over.task)
            else:
                done()
        if not died:
            return
        left = died  # tried again
    raise DataError(
        f"workers died {RETRIES + 1} times, {len(left)} tiles are left; use fewer or smaller tiles"
    )


def _on_ray(task: Task, job: Job, tiles: list[Tile], workers: int, done: Callable[[], object]) -> None:
    with ray_cluster(workers) as ray:
        remote = ray.remote(num_cpus=1, max_retries=RETRIES)(task)
        running = [remote.remote(job, tile) for tile in tiles]
        while running:
            (finished,), running = ray.wait(running, num_returns=1)
            ray.get(finished)
            done()
