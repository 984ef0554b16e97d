"""`contramap occupancy LOG --out DIR`: a laser log to the map that a robot's map server reads."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from mapping.errors import ConfigError
from reconstruction.files.output_folder import entries
from tools.options import write_json

if TYPE_CHECKING:
    import numpy as np

    from mapping.contramap import ContraMap
    from perception.lidar import LaserLog
    from tools.occupancy.landscape import LandscapeConfig

RESOLUTIONS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""Cells of the map that are offered [m]; the first with no more than MOST_CELLS is taken."""
MOST_CELLS = 16_000_000
MODEL_FILE = "contramap.npz"
MARGIN = 3.0
"""The map goes on for this many spacings of the hinge points beyond the last sample."""

Metres = tyro.conf.arg(metavar="M")


def occupancy(
    log: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")],
    *,
    out: Path,
    resolution: Annotated[float | None, Metres] = None,
    spacing: Annotated[float | None, Metres] = None,
    range_max: Annotated[float | None, Metres] = None,
    unknown_from: float = 0.5,
    seed: int = 0,
    overwrite: bool = False,
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Map a planar laser log: free, occupied and unknown cells for a robot's map server, and probabilities.

    Writes map.pgm and map.yaml (as map_server and nav2_map_server read them), map.npz (p(free), p(occupied),
    p(uncertain)), contramap.npz (the map itself, for load_map) and map.png. A tenth of the scans is held out
    to judge the map; the files are then made from all of them.

    Example: contramap occupancy intel-corrected.log.gz --out intel_map --json intel.json

    Args:
        log: CARMEN log (FLASER or ROBOTLASER1 lines, plain or gzipped), or an .npz with poses (S, 3) and
            ranges (S, B).
        out: Folder for the files; must be empty or absent, or see --overwrite.
        resolution: Size of a cell [m]; 0.05 by default, coarser for very large maps.
        spacing: Distance of hinge points [m]; found on held-out scans by default.
        range_max: Longest range that counts as a return [m]; found from the log by default, 40 at most.
        unknown_from: A cell is unknown from this p(uncertain) on.
        seed: Same seed, same files.
        overwrite: Replace what is in the folder.
        json: Also write the figures to this file.
    """
    figures = run_occupancy_log(log, out, resolution, spacing, range_max, unknown_from, seed, overwrite)
    write_json(figures, json)
    print(
        f"{figures['log']}: {figures['scans']} scans, AUC {figures['auc']:.4f} on held-out scans, "
        f"{figures['hinges']} hinge points {figures['spacing']:g} m apart, "
        f"cells of {figures['resolution']:g} m, fit {figures['train_s']:.2f} s"
    )
    print(f"map: {out / 'map.yaml'}")


def run_occupancy_log(
    path: Path,
    out: Path,
    resolution: float | None = None,
    spacing: float | None = None,
    range_max: float | None = None,
    unknown_from: float = 0.5,
    seed: int = 0,
    overwrite: bool = False,
) -> dict[str, Any]:
    """The command's work; returns its figures. Raises ConfigError or DataError for bad input."""
    import numpy as np
    from tqdm import tqdm

    from perception.laser_files import load_laser_log
    from perception.lidar import split_scans
    from tools.occupancy.landscape import (
        LandscapeConfig,
        find_spacing,
        fit_spacing,
        held_out_auc,
        samples_of,
    )

    for name, value in (("resolution", resolution), ("spacing", spacing), ("range_max", range_max)):
        if value is not None and not value > 0:
            raise ConfigError(f"--{name.replace('_', '-')} must be > 0 [m], got {value}")
    if not 0 < unknown_from <= 1:
        raise ConfigError(f"--unknown-from must lie between 0 and 1, got {unknown_from}")
    if out.exists() and (not out.is_dir() or (entries(out) and not overwrite)):
        raise ConfigError(f"{out} is not an empty folder; choose another --out or add --overwrite")
    if entries(out) and not (out / MODEL_FILE).is_file():
        raise ConfigError(
            f"{out} holds no {MODEL_FILE}, so it is no map of this command and is kept; choose another --out"
        )
    log = load_laser_log(path)
    config = _beams(log, LandscapeConfig(), range_max)
    rng = np.random.default_rng(seed)
    train, test = split_scans(len(log.poses), rng, config.held_out)
    steps = 2 + (len(config.spacings) if spacing is None else 0)
    with tqdm(total=steps, desc=f"{log.name}: fits", disable=None) as bar:
        scores: dict[float, float] = {}
        if spacing is None:
            scores = find_spacing(log, train, config, rng, lambda: bar.update())
            # Without a held-out sample of both classes every score is NaN; then the middle spacing.
            middle = list(scores)[len(scores) // 2]
            spacing = middle if np.isnan(list(scores.values())).any() else max(scores, key=scores.__getitem__)
        judged = fit_spacing(samples_of(log, train, config, rng), spacing, config, rng)
        auc = held_out_auc(judged, samples_of(log, test, config, rng))
        bar.update()
        every = samples_of(log, np.arange(len(log.poses)), config, rng)
        start = time.perf_counter()
        model = fit_spacing(every, spacing, config, rng)
        fitting = time.perf_counter() - start
        bar.update()
    out.mkdir(parents=True, exist_ok=True)
    drawn = _draw(model, every.X, spacing, resolution, unknown_from, out)
    return {
        "log": log.name,
        "scans": len(log.poses),
        "corrupt_lines": log.corrupt_lines,
        "range_max": config.beams.range_max,
        "auc": auc,
        "spacing": spacing,
        "spacings_tried": {f"{key:g}": value for key, value in scores.items()},
        "hinges": len(model.hinges),
        "samples": len(every.X),
        "train_s": fitting,
        **drawn,
        "seed": seed,
    }


def _beams(log: LaserLog, config: LandscapeConfig, range_max: float | None) -> LandscapeConfig:
    """The settings with the longest range given, or found in the log."""
    from tools.occupancy.landscape import clean_beams

    if range_max is None:
        return clean_beams(log, config)
    return replace(config, beams=replace(config.beams, range_max=range_max))


def _draw(
    model: ContraMap,
    X: np.ndarray,
    spacing: float,
    resolution: float | None,
    unknown_from: float,
    out: Path,
) -> dict[str, Any]:
    """Evaluate the map on cells around its samples, write every file; size, shares of states and seconds."""
    import numpy as np

    from tools.occupancy.fit import draw
    from tools.occupancy.map_files import write_map
    from tools.reproduce.occupancy_figures import draw_panels

    low, high = X.min(axis=0) - MARGIN * spacing, X.max(axis=0) + MARGIN * spacing
    if resolution is None:
        sizes = (np.prod(np.ceil((high - low) / size)) for size in RESOLUTIONS)
        resolution = next((r for r, size in zip(RESOLUTIONS, sizes) if size <= MOST_CELLS), RESOLUTIONS[-1])
    counts = np.maximum(np.ceil((high - low) / resolution).astype(int), 1)
    if np.prod(counts, dtype=float) > 4 * MOST_CELLS:
        raise ConfigError(f"{counts[0]} x {counts[1]} cells of {resolution} m; choose a larger --resolution")
    start = time.perf_counter()
    x, y = (corner + resolution * (np.arange(n) + 0.5) for corner, n in zip(low, counts))
    probabilities = draw(model, (x, y))
    drawing = time.perf_counter() - start
    model.save(out / MODEL_FILE)  # first: by it a map of this command is known
    shares = write_map(out, probabilities, (x, y), resolution, unknown_from)
    step = max(1, int(max(counts)) // 1000)
    classes = {
        f"p({name})": probabilities[::step, ::step, i]
        for i, name in enumerate(("free", "occupied", "uncertain"))
    }
    draw_panels(out / "map.png", (low, high), classes, "viridis", "probability")
    return {
        "resolution": resolution,
        "cells": [int(n) for n in counts],
        "infer_s": drawing,
        "shares": shares,
    }
