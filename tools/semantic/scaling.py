"""Time and memory of a semantic map against samples and hinge points.

Knows made-up streets and what fits of them cost; must not know scans.
"""

from __future__ import annotations

import resource
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from mapping.errors import DataError
from tools.markdown import markdown_table
from tools.runs.kept import cached_run
from tools.runs.workers import CRASHED, run_in_workers

QUERIES = 100_000
"""Points that are asked for."""
SAMPLES = 1_000_000
"""Samples while hinge points vary."""
PER_HINGE = 10
"""Samples a hinge point, about, while both vary."""
HINGES_A_SQUARE = 200.0
"""Hinge points that a square metre of street gets, about."""
STREET = 12.0
"""Distance of the walls along streets [m]."""
WALL = 6.0
"""Height of the walls [m]."""
CITY = 10**10
"""Points of the city that is worked out."""
OVERLAP = (70 / 60) ** 2
"""Points that a tile of 60 m with an overlap of 5 m reads, as a multiple of its own."""
WORKERS = 100
POINT_BYTES = 13
"""A point that a worker is sent: three coordinates and a label."""


@dataclass(frozen=True)
class Point:
    """One measurement: so many samples in a city of this side [m], all spacings times a scale."""

    samples: int
    side: float
    scale: float
    threads: int


def sweeps(
    out: Path, samples: tuple[int, ...], scales: tuple[float, ...], threads: int, seed: int
) -> dict[str, Any]:
    """Time and memory against samples, and against hinge points alone, with exponents, and a city worked out.

    A measurement that is under out/runs is not made again.
    """
    from tqdm import tqdm

    most = min(SAMPLES, max(samples))
    points = {
        "together": [Point(n, side_of(n), 1.0, threads) for n in samples],
        "hinges": [Point(most, 2 * side_of(most), scale, threads) for scale in scales],
    }
    figures: dict[str, Any] = {"threads": threads, "queries": QUERIES}
    for sweep, some in points.items():
        rows = [_measured(out, point, seed) for point in tqdm(some, desc=sweep, disable=None)]
        against = "samples" if sweep == "together" else "hinges"
        figures[sweep] = {"rows": rows, "exponents": exponents(rows, against)}
    figures["city"] = city(figures["together"]["rows"][-1])
    return figures


def side_of(samples: int) -> float:
    """Side [m] of the city that has a tenth as many hinge points as samples."""
    surface = 1 + WALL / STREET
    return float(np.sqrt(samples / PER_HINGE / HINGES_A_SQUARE / surface))


def streets(count: int, side: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """About `count` points (N, 3) [m] of a ground (0), walls along streets (1) and posts (2), and labels."""
    walls, posts = int(count * WALL / (STREET + WALL)), count // 50
    ground = count - walls - posts
    X = rng.uniform(0, side, (count, 3))
    X[:ground, 2] = rng.normal(0, 0.01, ground)
    X[ground:, 2] = rng.uniform(0.1, WALL, count - ground)
    X[ground : ground + walls, 1] = STREET * rng.integers(0, int(side / STREET) + 1, walls)
    places = rng.uniform(0, side, (int(side**2 / 50) + 1, 2))
    X[ground + walls :, :2] = places[rng.integers(0, len(places), posts)]
    X[ground + walls :, 2] *= 0.5
    return X, np.repeat([0, 1, 2], [ground, walls, posts])


def measure(point: Point, seed: int) -> dict[str, float]:
    """Seconds, processor seconds and peak memory above what imports and data take, in a fresh process."""
    import torch

    from mapping.multiscale import MultiscaleConfig, MultiscaleMap

    torch.set_num_threads(point.threads)
    rng = np.random.default_rng(seed)
    default = MultiscaleConfig()
    # Every sample counts: none are merged.
    config = replace(
        default,
        merge=0.0,
        spacings=tuple(tuple(point.scale * d for d in spacing) for spacing in default.spacings),
    )
    few, labels = streets(100, 3.0, rng)
    MultiscaleMap(config).fit(few, labels, 3, rng).predict_proba(few)  # loops are compiled
    X, y = streets(point.samples, point.side, rng)
    asked = streets(QUERIES, point.side, rng)[0] + rng.normal(0, 0.3, (QUERIES, 3))
    before = _peak_mb()
    start, start_cpu = perf_counter(), process_time()
    model = MultiscaleMap(config).fit(X, y, 3, rng)
    fitted, fitted_cpu = perf_counter(), process_time()
    model.predict_proba(asked)
    return {
        "samples": float(len(X)),
        "hinges": float(len(model.W)),
        "steps": float(model.report.iterations),
        "fit_s": fitted - start,
        "fit_cpu_s": fitted_cpu - start_cpu,
        "query_s": perf_counter() - fitted,
        "query_cpu_s": process_time() - fitted_cpu,
        "memory_mb": _peak_mb() - before,
        "map_mb": (model.W.nbytes + 12 * len(model.W)) / 2**20,
    }


def exponents(rows: Sequence[dict[str, Any]], against: str) -> dict[str, float]:
    """Of time, time a step and memory: how steeply they rise from the first row to the last, and at most from
    one to the next, as powers of a column."""
    rows = [
        {**row, "step_cpu_s": row["fit_cpu_s"] / max(row["steps"], 1)} for row in rows if "skipped" not in row
    ]
    out: dict[str, float] = {}
    if len(rows) < 2:
        return out
    x = np.log([row[against] for row in rows])
    for key in ("fit_cpu_s", "step_cpu_s", "query_cpu_s", "memory_mb"):
        y = np.log([max(row[key], 1e-3) for row in rows])
        out[key] = float((y[-1] - y[0]) / (x[-1] - x[0]))
        out[f"{key}_steepest"] = float((np.diff(y) / np.diff(x)).max())
    return out


def city(row: dict[str, Any]) -> dict[str, float]:
    """What CITY points take at a row's cost a sample: processor hours, memory of a worker at so many samples,
    bytes sent and kept [TB]."""
    if "skipped" in row:
        return {}
    return {
        "points": float(CITY),
        "cpu_hours": CITY * OVERLAP * row["fit_cpu_s"] / row["samples"] / 3600,
        "hours": CITY * OVERLAP * row["fit_cpu_s"] / row["samples"] / 3600 / WORKERS,
        "workers": float(WORKERS),
        "worker_mb_a_million": 1e6 * row["memory_mb"] / row["samples"],
        "sent_tb": CITY * OVERLAP * POINT_BYTES / 1e12,
        "kept_tb": CITY * row["map_mb"] * 2**20 / row["samples"] / 1e12,
    }


def scaling_table(figures: dict[str, Any]) -> str:
    """The sweeps in markdown, exponents below each, and the city."""
    header = [
        "samples",
        "hinge points",
        "steps",
        "fit, CPU (wall) [s]",
        "100,000 queries, CPU [s]",
        "memory [MB]",
    ]
    parts = []
    for sweep in ("together", "hinges"):
        rows = []
        for row in figures[sweep]["rows"]:
            if "skipped" in row:
                rows.append([f"{row['samples']:,}", row["skipped"], "", "", "", ""])
                continue
            rows.append(
                [
                    f"{row['samples']:,.0f}",
                    f"{row['hinges']:,.0f}",
                    f"{row['steps']:.0f}",
                    f"{row['fit_cpu_s']:.2f} ({row['fit_s']:.2f})",
                    f"{row['query_cpu_s']:.2f}",
                    f"{row['memory_mb']:.0f}",
                ]
            )
        found = figures[sweep]["exponents"]
        names = {"fit_cpu_s": "fit", "step_cpu_s": "a step", "query_cpu_s": "queries", "memory_mb": "memory"}
        powers = [
            f"{name} {found[key]:.2f} (steepest {found[f'{key}_steepest']:.2f})"
            for key, name in names.items()
            if key in found
        ]
        against = "samples" if sweep == "together" else "hinge points alone"
        parts.append(
            markdown_table([header, *rows]) + f"\nExponents against {against}: {', '.join(powers)}.\n"
        )
    if figures["city"]:
        parts.append(
            "{points:.0e} points: {cpu_hours:.0f} processor hours, {hours:.1f} h on {workers:.0f} workers of "
            "one thread, {worker_mb_a_million:.0f} MB a worker for each million samples of a tile; "
            "{sent_tb:.2f} TB sent to workers, maps of {kept_tb:.2f} TB.\n".format(**figures["city"])
        )
    return "\n".join(parts)


def _measured(out: Path, point: Point, seed: int) -> dict[str, Any]:
    def run() -> dict[str, Any]:
        (done,) = run_in_workers(partial(measure, seed=seed), [point], 1, point.threads)
        if done.result is None:
            raise DataError(str(done.error or CRASHED))
        return done.result

    name = f"curve-{point.samples}-{point.scale:g}-{point.side:.0f}.json"
    try:
        return cached_run(out / "runs" / name, {**asdict(point), "seed": seed}, run)
    except DataError as error:
        return {"samples": point.samples, "skipped": str(error)}  # not kept: tried again the next time


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
