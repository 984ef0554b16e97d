"""Whether maps in tiles are what they should be: one tile's answers away from seams, whatever was killed.

Knows jobs, tiles and one folder to work in; must not know tables.
"""

from __future__ import annotations

import os
import signal
import threading
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path

import numpy as np

from mapping.multiscale import MultiscaleConfig, MultiscaleMap, Whole
from tools.reproduce.semantic.run import miou
from tools.reproduce.semantic.scenes import load_scene
from tools.runs.workers import run_in_workers
from tools.semantic.inputs import read_scans
from tools.semantic.tiles import STEPS, Job, Tile, ask_tiles, create_store, fit_tile, fitted_so, plan_tiles
from tools.semantic.workers import Task, make_tiles
from tools.stopwatch import Stopwatch

SIDE, OVERLAP, VOXEL = 40.0, 5.0, 0.2
"""Tiles that are compared, and the voxels their sides are multiples of [m]."""
HELD_OUT = 0.1
AROUND = 0.5
"""Standard deviation [m] of places around held-out points."""
SAME = 1e-3
"""Probabilities that differ by less are the same."""
KILL_S = 0.3
"""A worker that is to be killed is, so long [s] after its task began."""


@dataclass(frozen=True)
class TilesTrial:
    """One map against many of the first scan of a sequence, a tenth of its points held out. steps, tolerance:
    of the fits, see `fitted_so`; folder: to work in."""

    data: Path
    sequence: str
    folder: Path
    steps: int
    tolerance: float | None
    threads: int
    seed: int


def one_against_many(trial: TilesTrial) -> dict[str, float]:
    """Differences, times and mIoU of one tile and many; in a fresh process."""
    import torch

    torch.set_num_threads(trial.threads)
    scene = load_scene(trial.data, "semantickitti", trial.sequence)
    rng = np.random.default_rng([trial.seed, 2])
    held = rng.random(len(scene.X)) < HELD_OUT
    X, y, truth = scene.X[~held].astype(np.float32), scene.y[~held], scene.y[held]
    near = scene.X[held].astype(np.float32)
    asked = np.concatenate([near, near + rng.normal(0, AROUND, near.shape).astype(np.float32)])
    config = fitted_so(MultiscaleConfig(), trial.steps, trial.tolerance)
    whole = Whole.of(X, y, scene.classes, config)
    job = Job(trial.folder, plan_tiles(X, VOXEL, SIDE, OVERLAP), config, whole, trial.seed)
    (trial.folder / "tiles").mkdir(parents=True, exist_ok=True)
    np.save(trial.folder / "points.npy", X)
    np.save(trial.folder / "labels.npy", y.astype(np.uint8))
    MultiscaleMap(config).fit(X[::30], y[::30], scene.classes, np.random.default_rng(0))  # loops are compiled
    watch = Stopwatch()
    model = MultiscaleMap(config).fit(X, y, scene.classes, np.random.default_rng(trial.seed), whole)
    figures = watch.figures("one")
    tiles, watch = list(job.plan.tiles()), Stopwatch()
    for tile in tiles:
        fit_tile(job, tile)
    figures |= watch.figures("many")
    one, many = model.predict_proba(asked), ask_tiles(job, tiles, asked)
    gap = np.abs(one - many).max(axis=1)
    away = np.max([job.plan.weight(tile, asked) for tile in tiles], axis=0) == 1
    labels = [p[:, :-1].argmax(axis=1) for p in (one, many)]
    return {
        **figures,
        "tiles": float(len(tiles)),
        "taken": float(model.report.iterations),
        "miou_one": miou(truth, labels[0][: len(truth)]),
        "miou_many": miou(truth, labels[1][: len(truth)]),
        "label_same": float((labels[0] == labels[1]).mean()),
        "away_share": float(away.mean()),
        "away_same": float((gap[away] < SAME).mean()),
        **{f"away_{q}": float(np.quantile(gap[away], q / 100)) for q in (50, 90, 99)},
        **{f"seams_{q}": float(np.quantile(gap[~away], q / 100)) for q in (50, 90, 99)},
    }


def killed_against_whole(scans: tuple[Path, ...], folder: Path, seed: int) -> dict[str, float]:
    """Three runs in tiles of the same scans: undisturbed with one worker; with two, of which one is killed in
    the middle of a fit and one in the middle of writing; killed as a whole and run again. Says whether tiles
    and voxels have the same bytes."""
    clouds = read_scans(scans, seed)
    X = np.concatenate([cloud.points for cloud in clouds]).astype(np.float32)
    y = np.concatenate([cloud.labels for cloud in clouds])
    config = fitted_so(MultiscaleConfig(), STEPS, None)
    whole = Whole.of(X, y, len(clouds[0].names), config)
    plan = plan_tiles(X, VOXEL, SIDE, OVERLAP)
    prints, deaths = {}, 0
    for name in ("whole", "worker", "run"):
        job = Job(folder / name, plan, config, whole, seed)
        (job.folder / "tiles").mkdir(parents=True, exist_ok=True)
        np.save(job.folder / "points.npy", X)
        np.save(job.folder / "labels.npy", y.astype(np.uint8))
        create_store(job, clouds[0].names)
        if name == "worker":
            make_tiles(job, 2, "local", lambda task: partial(_killed_once, task))
        elif name == "run":
            # In a process that is killed with all its workers after some tiles, then anew.
            deaths += sum(done.died for done in run_in_workers(_killed_run, [job], 1))
        make_tiles(job, 1, "local")
        deaths += len(list(job.folder.glob("*.killed")))
        prints[name] = print_of(job.folder)
    return {
        "points": float(len(X)),
        "tiles": float(len(list(plan.tiles()))),
        "files": float(sum(1 for _ in _made(folder / "whole"))),
        "deaths": float(deaths),
        "worker_same": float(prints["worker"] == prints["whole"]),
        "run_same": float(prints["run"] == prints["whole"]),
    }


def print_of(folder: Path) -> str:
    """A hash of the names and bytes of a run's tiles and voxels."""
    found = sha256()
    for path in _made(folder):
        found.update(str(path.relative_to(folder)).encode() + path.read_bytes())
    return found.hexdigest()


def _made(folder: Path) -> list[Path]:
    every = [*(folder / "tiles").iterdir(), *(folder / "voxels.zarr").rglob("*")]
    return sorted(path for path in every if path.is_file())


def _killed_once(task: Task, job: Job, tile: Tile) -> None:
    """The task; the first worker that begins it at a tile with many points is killed in the middle."""
    name = getattr(task, "__name__", "task")
    marker = job.folder / f"{name}.killed"
    points = np.load(job.folder / "points.npy", mmap_mode="r")
    if not marker.exists() and job.plan.within(tile, points).mean() > 0.2:
        marker.touch()
        threading.Timer(KILL_S, lambda: os.kill(os.getpid(), signal.SIGKILL)).start()
    task(job, tile)


def _killed_run(job: Job) -> None:
    """Fits and writes tiles; the process is killed when half of the fits are done."""

    def spoiled(task: Task) -> Task:
        def one(job: Job, tile: Tile) -> None:
            task(job, tile)
            if len(list((job.folder / "tiles").glob("*.npz"))) * 2 >= len(list(job.plan.tiles())):
                os.kill(os.getpid(), signal.SIGKILL)

        return one

    make_tiles(job, 1, "local", spoiled)
