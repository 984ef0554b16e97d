"""`contramap benchmark scaling`: time and memory against hinge points and objects, beside V-PRISM."""

from __future__ import annotations

import resource
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import numpy as np
import tyro

from mapping.files import temporary_beside
from tools.runs.workers import CRASHED, run_in_workers

SAMPLES = 20_000
"""Training samples of every measurement."""
QUERIES = 20_000
"""Points that are asked for."""
GAMMA_SPACING = 2.5
"""gamma * spacing^2 of the hinge lattice: V-PRISM's 1000 / m^2 at 5 cm."""
FIXED_OBJECTS = 3
"""Objects while hinge points vary."""
FIXED_HINGES = 1000
"""Hinge points while objects vary."""
BOX = np.array([0.8, 0.6, 0.3])
"""Space that samples and hinge points fill [m]."""
VPRISM_COPIES = 6
"""K x H x H float64 arrays that V-PRISM holds at its peak: prior, precision, factor, covariances."""


@dataclass(frozen=True)
class Point:
    """One measurement to take."""

    method: str
    hinges: int
    objects: int
    threads: int

    @property
    def needed_bytes(self) -> int:
        """What the covariances of V-PRISM take; ContraMap holds nothing of that order."""
        return VPRISM_COPIES * 8 * (self.objects + 1) * self.hinges**2 if self.method == "vprism" else 0


def scaling(
    *,
    out: Path,
    methods: tuple[str, ...] = ("contramap", "vprism"),
    hinges: tuple[int, ...] = (300, 1000, 3000, 10000),
    objects: tuple[int, ...] = (1, 2, 5, 10, 20),
    repeat: int = 3,
    threads: int = 1,
    seed: int = 0,
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Measure fit and query time and memory against the number of hinge points and of objects.

    Every measurement runs in a process of its own, on the same synthetic balls on a table. What needs more
    memory than the machine has is left out and said so.
    Example: contramap benchmark scaling --out scaling

    Args:
        out: Folder for scaling.json and scaling.png.
        methods: contramap, vprism.
        hinges: Numbers of hinge points, with three objects.
        objects: Numbers of objects, with 1000 hinge points.
        repeat: Repetitions; medians are given.
        threads: Threads of each measurement.
        seed: Seed of the samples.
        json: Also write the figures to this file.
    """
    from tqdm import tqdm

    from mapping.errors import ConfigError
    from tools.options import write_json

    if unknown := set(methods) - {"contramap", "vprism"}:
        raise ConfigError(f"unknown method {unknown.pop()!r}; valid methods: contramap, vprism")
    sweeps = {
        "hinges": [Point(m, h, FIXED_OBJECTS, threads) for m in methods for h in hinges],
        "objects": [Point(m, FIXED_HINGES, k, threads) for m in methods for k in objects],
    }
    figures: dict[str, Any] = {"threads": threads, "samples": SAMPLES, "queries": QUERIES}
    for sweep, points in sweeps.items():
        figures[sweep] = [_measured(point, seed, repeat) for point in tqdm(points, desc=sweep)]
    write_json(figures, out / "scaling.json")
    write_json(figures, json)
    draw(figures, out / "scaling.png")
    for sweep in sweeps:
        print(f"\n{sweep:>8} {'method':>10} {'fit [s]':>9} {'query [s]':>10} {'memory [MB]':>12}")
        for row in figures[sweep]:
            values = row.get("skipped") or "{fit_s:9.3f} {query_s:10.3f} {memory_mb:12.0f}".format(**row)
            print(f"{row[sweep]:8d} {row['method']:>10} {values}")


def problem(hinges: int, objects: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Samples X (N, 3) of balls in empty space, their classes y (N,), hinge points (H, 3) and gamma.

    The hinge points are a lattice of as many points as asked for, give or take its edge.
    """
    rng = np.random.default_rng(seed)
    X = rng.uniform(0, BOX, (SAMPLES, 3)).astype(np.float32)
    centres = rng.uniform(0.05, BOX - 0.05, (objects, 3)).astype(np.float32)
    distance = np.linalg.norm(X[:, None] - centres, axis=2)
    y = np.where(distance.min(1) < 0.05, distance.argmin(1) + 1, 0)
    X[:objects], y[:objects] = centres, np.arange(1, objects + 1)
    spacing = float((BOX.prod() / hinges) ** (1 / 3))
    counts = np.maximum(np.round(BOX / spacing), 1).astype(int)
    axes = [(np.arange(n) + 0.5) * (side / n) for n, side in zip(counts, BOX)]
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3).astype(np.float32)
    return X, y, lattice, GAMMA_SPACING / spacing**2


def measure(point: Point, seed: int) -> dict[str, float]:
    """Seconds and peak memory above what imports take; meant to be called in a fresh process."""
    import torch

    from mapping.baselines.vprism import VPrism, VPrismConfig
    from mapping.config import MapConfig
    from mapping.contramap import ContraMap

    torch.set_num_threads(point.threads)
    X, y, hinges, gamma = problem(point.hinges, point.objects, seed)
    queries = np.random.default_rng(seed + 1).uniform(0, BOX, (QUERIES, 3)).astype(np.float32)
    rng = np.random.default_rng(seed)
    before = _resident_mb()
    start = perf_counter()
    model: ContraMap | VPrism
    if point.method == "vprism":
        model = VPrism(VPrismConfig(gamma=gamma)).fit(X, y, hinges, rng, classes=point.objects + 1)
    else:
        noise = rng.uniform(0, BOX, (SAMPLES // 40, 3)).astype(np.float32)
        labels = np.append(y, np.full(len(noise), point.objects + 1))
        model = ContraMap(MapConfig(gamma=gamma, device="cpu"))
        model.fit(np.concatenate([X, noise]), labels, hinges=hinges, classes=point.objects + 2)
    fitted = perf_counter()
    model.predict_proba(queries)
    done = perf_counter()
    return {
        "hinges": len(hinges),
        "fit_s": fitted - start,
        "query_s": done - fitted,
        "memory_mb": max(_peak_mb() - before, 0.0),
    }


def _measured(point: Point, seed: int, repeat: int) -> dict[str, Any]:
    row: dict[str, Any] = {"method": point.method, "hinges": point.hinges, "objects": point.objects}
    free = _available_bytes()
    if point.needed_bytes > 0.8 * free:
        wanted = f"needs {point.needed_bytes / 1e9:.0f} GB, {free / 1e9:.0f} GB are free"
        return {**row, "skipped": wanted}
    runs: list[dict[str, Any]] = []
    for _ in range(repeat):  # a fresh process each, so that memory is that of one run
        (done,) = run_in_workers(partial(measure, seed=seed), [point], 1, point.threads)
        if done.result is None:
            return {**row, "skipped": str(done.error or CRASHED)}
        runs.append(done.result)
    return {
        **row,
        **{key: float(np.median([run[key] for run in runs])) for key in runs[0] if key != "hinges"},
    }


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def _available_bytes() -> int:
    """Memory that can be had without swapping."""
    for line in Path("/proc/meminfo").read_text().splitlines():
        if line.startswith("MemAvailable"):
            return 1024 * int(line.split()[1])
    return 8 << 30


def draw(figures: dict[str, Any], path: Path) -> None:
    """Time and memory against hinge points and objects, four panels."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    from tools.evaluation.figures import COLOURS

    panels, axes = plt.subplots(2, 2, figsize=(9, 6.4), dpi=150, layout="constrained", sharex="col")
    for column, sweep in enumerate(("hinges", "objects")):
        rows = [row for row in figures[sweep] if "skipped" not in row]
        for name in dict.fromkeys(row["method"] for row in rows):
            of = [row for row in rows if row["method"] == name]
            x = [row[sweep] for row in of]
            colour = COLOURS[name]
            axes[0, column].plot(x, [r["fit_s"] for r in of], "o-", ms=4, color=colour, label=f"{name}, fit")
            label = f"{name}, {figures['queries']:,} queries"
            axes[0, column].plot(x, [r["query_s"] for r in of], "o--", ms=4, color=colour, label=label)
            axes[1, column].plot(
                x, [max(r["memory_mb"], 1) for r in of], "o-", ms=4, color=colour, label=name
            )
        for cell, text in zip(axes[:, column], ("seconds", "memory [MB]")):
            cell.set(xscale="log", yscale="log", ylabel=text)
            cell.grid(color="#e6e8eb")
            cell.spines[["top", "right"]].set_visible(False)
            cell.set_ylim(top=cell.get_ylim()[1] * 12)  # room for the legend
            cell.legend(frameon=False, fontsize=8, loc="upper left")
            cell.yaxis.set_major_formatter("{x:g}")
            ticks = sorted({row[sweep] for row in figures[sweep]})
            cell.set_xticks(ticks, [f"{tick:,}" for tick in ticks], minor=False)
            cell.set_xticks([], minor=True)
        axes[1, column].set_xlabel({"hinges": "hinge points", "objects": "objects"}[sweep])
    with temporary_beside(path) as partial:
        panels.savefig(partial, format="png")
    plt.close(panels)
