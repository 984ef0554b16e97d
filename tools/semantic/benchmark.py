"""`contramap benchmark semantic`: what semantic maps cost, and whether tiles are what one tile is.

Knows which measurements there are and how they are shown; must not know how they are made. Each is made in a
process of its own and kept under out/runs, so that a command that was cut off goes on where it stopped.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Annotated, Any, Literal

import tyro

from mapping.errors import ConfigError, DataError
from tools.options import write_json

What = Literal["curves", "scan", "merged", "tiles", "killed"]
KILLED_SCANS = 3
"""Scans that are mapped in tiles while workers are killed."""


def semantic_benchmark(
    *,
    out: Path,
    what: tuple[What, ...] = ("curves",),
    data: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    sequences: tuple[str, ...] = ("05",),
    merged: str = "00",
    steps: tuple[int, ...] = (100,),
    tolerances: tuple[float, ...] = (),
    samples: tuple[int, ...] = (10_000, 100_000, 1_000_000, 10_000_000),
    scales: tuple[float, ...] = (16.0, 5.0, 1.6, 0.6, 0.35),
    repeat: int = 3,
    threads: int = 1,
    seed: int = 0,
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Measure a semantic map: time and memory against samples and hinge points of made-up streets, and a city
    worked out (curves); on SemanticKITTI what a scan takes beside other methods (scan), several scans as one
    map (merged), one tile against many (tiles), and runs of which workers are killed (killed).

    Example: contramap benchmark semantic --out costs --what scan tiles --data semantickitti

    Args:
        out: Folder for benchmark.json and table.md.
        what: Measurements.
        data: Folder that holds sequences/, for all but curves.
        sequences: Sequences whose first scan is taken.
        merged: Sequence whose scans are taken together.
        steps: Local steps of fits whose tiles are compared with one tile.
        tolerances: The same of quasi-Newton fits.
        samples: Numbers of samples of the curves, with a tenth as many hinge points.
        scales: Factors of all distances of hinge points, with a million samples (or the most, if fewer).
        repeat: Times that a scan's fit and queries are measured; medians are shown.
        threads: Threads of each measurement.
        seed: Seed of samples, queries and noise.
        json: Also write the figures to this file.
    """
    from mapping.files import write_atomically
    from tools.provenance import provenance
    from tools.semantic.scaling import scaling_table, sweeps
    from tools.semantic.tables import killed_table, scans_table, tiles_table

    if not samples or min(samples) < 100 or not scales or min(scales) <= 0 or threads < 1 or repeat < 1:
        raise ConfigError(
            "--samples must be at least 100 each, --scales > 0, --threads and --repeat at least 1"
        )
    if min(steps, default=1) < 1 or min(tolerances, default=1) <= 0:
        raise ConfigError("--steps must be at least 1 and --tolerances > 0")
    found: dict[str, Any] = {}
    parts = []
    runs = _Runs(out, data, threads, seed)
    if "curves" in what:
        found["curves"] = sweeps(out, samples, scales, threads, seed)
        parts.append(scaling_table(found["curves"]))
    if "scan" in what:
        found["scan"] = {name: runs.scan(name, repeat) for name in sequences}
    if "merged" in what:
        found["merged"] = {merged: {"merged": runs.trial("merged", merged, 0)}}
    if "scan" in found or "merged" in found:
        parts.append(scans_table(found.get("scan", {}), found.get("merged", {})))
    if "tiles" in what:
        fits = [*((count, None) for count in steps), *((0, limit) for limit in tolerances)]
        found["tiles"] = [runs.tiles(name, *fit) for name in sequences for fit in fits]
        parts.append(tiles_table(found["tiles"]))
    if "killed" in what:
        found["killed"] = runs.killed(merged)
        parts.append(killed_table(found["killed"]))
    figures = {**found, "threads": threads, "seed": seed}
    write_json(figures, out / "benchmark.json")
    write_json(figures, json)
    table = "\n".join(parts)
    write_atomically(out / "table.md", f"{provenance()}\n\n{table}".encode())
    print(table)


class _Runs:
    """Measurements on real scans, each in a process of its own, kept under out/runs."""

    def __init__(self, out: Path, data: Path | None, threads: int, seed: int) -> None:
        self.out, self._data, self.threads, self.seed = out, data, threads, seed

    @property
    def data(self) -> Path:
        if self._data is None:
            raise ConfigError("--data must name the folder that holds sequences/")
        return self._data

    def scan(self, sequence: str, repeat: int) -> dict[str, Any]:
        """Medians of a scan's fit and of many queries, and the methods side by side."""
        out = {}
        for what in ("fit", "ask"):
            rows = [self.trial(what, sequence, number) for number in range(repeat)]
            out[what] = {key: median(row[key] for row in rows) for key in rows[0]}
        return {**out, "compare": self.trial("compare", sequence, 0)}

    def trial(self, what: str, sequence: str, number: int) -> dict[str, float]:
        """One measurement of `tools.semantic.costs`."""
        from tools.semantic.costs import Trial, measure

        trial = Trial(what, self.data, sequence, self.threads, self.seed)
        return self._kept(
            f"{what}-{sequence}-{number}",
            {"sequence": sequence, "threads": self.threads, "seed": self.seed},
            lambda: self._alone(measure, trial),
        )

    def tiles(self, sequence: str, steps: int, tolerance: float | None) -> dict[str, Any]:
        """One tile against many, fitted in local steps or to a tolerance."""
        from tools.semantic.agreement import TilesTrial, one_against_many

        name = f"tiles-{sequence}-{steps or f'{tolerance:g}'}"
        folder = self._folder(name)
        trial = TilesTrial(self.data, sequence, folder, steps, tolerance, self.threads, self.seed)
        settings = {"sequence": sequence, "steps": steps, "tolerance": tolerance}
        found = self._kept(
            name,
            {**settings, "threads": self.threads, "seed": self.seed},
            lambda: self._alone(one_against_many, trial),
            folder,
        )
        return {**settings, **found}

    def killed(self, sequence: str) -> dict[str, float]:
        """Runs of which workers are killed."""
        from tools.semantic.agreement import killed_against_whole

        name = f"killed-{sequence}"
        folder, places = self._folder(name), self.data / "sequences" / sequence
        scans = tuple(sorted((places / "velodyne").glob("*.bin"))[:KILLED_SCANS])
        if not scans:
            raise DataError(f"{places}: no scans; --data must name the folder that holds sequences/")
        settings = {"scans": len(scans), "seed": self.seed}
        # In this process: what has workers of its own cannot be one.
        return self._kept(name, settings, lambda: killed_against_whole(scans, folder, self.seed), folder)

    def _folder(self, name: str) -> Path:
        return self.out / "work" / name

    def _kept(
        self, name: str, settings: dict[str, Any], make: Callable[[], Any], folder: Path | None = None
    ) -> dict[str, Any]:
        """The figures that `make` gives, unless they are kept; folder: what it works in, empty at first and
        removed after."""
        import shutil

        from tools.runs.kept import cached_run

        def run() -> dict[str, Any]:
            if folder is not None:
                shutil.rmtree(folder, ignore_errors=True)
            found: dict[str, Any] = make()
            if folder is not None:
                shutil.rmtree(folder, ignore_errors=True)
            return found

        return cached_run(self.out / "runs" / f"{name}.json", settings, run)

    def _alone(self, function: Callable[[Any], dict[str, float]], task: Any) -> dict[str, float]:
        """function(task) in a fresh process."""
        from tools.runs.workers import CRASHED, run_in_workers

        (done,) = run_in_workers(function, [task], 1, self.threads)
        if done.result is None:
            raise done.error or DataError(CRASHED)
        return done.result
