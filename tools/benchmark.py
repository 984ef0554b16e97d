"""`contramap benchmark latency`: medians per stage and peak memory on one frame."""

from __future__ import annotations

import platform
import resource
import sys
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Annotated

import tyro

from mapping.errors import ConfigError
from reconstruction.config import TABLETOP, PipelineConfig, PresetName
from tools.options import pipeline_config, write_json


def latency(
    *,
    frame: Path,
    repeat: int = 7,
    preset: PresetName = "tabletop",
    prior: str | None = None,
    device: str | None = None,
    seed: int = 0,
    set: tuple[str, ...] = (),
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    settings: Annotated[PipelineConfig, tyro.conf.arg(name="")] = TABLETOP,
) -> None:
    """Time the pipeline from a frame in memory to meshes in memory; medians over repeats.

    Example: OMP_NUM_THREADS=2 contramap benchmark latency --frame FRAME --repeat 7 --json latency.json

    Args:
        frame: Frame folder or .npz file.
        repeat: Counted runs, after one that warms up.
        preset: tabletop or paper.
        prior: learned or none.
        device: cpu, cuda or auto.
        seed: Seed of every run.
        set: Settings as text, such as mesh.spacing=0.003; the same as --mesh.spacing 0.003.
        json: Also write the figures to this file.
        settings: Every setting of the pipeline; the defaults are those of --preset.
    """
    import torch

    from perception.frame_io import load_frame
    from reconstruction import reconstruct

    if repeat < 1:
        raise ConfigError(f"--repeat must be at least 1, got {repeat}")
    config = pipeline_config(settings, texts=set, device=device, prior=prior)
    runs: list[dict[str, float]] = []
    for _ in range(repeat + 1):
        start = perf_counter()
        loaded = load_frame(frame)
        load_ms = (perf_counter() - start) * 1e3
        reconstruction = reconstruct(loaded, config, seed)
        runs.append({"load": load_ms, **reconstruction.timings_ms})
    counted = runs[1:]
    stages = {stage: round(median(run[stage] for run in counted), 2) for stage in counted[0]}
    total = stages.pop("total")
    spread = [round(pick(run["total"] for run in counted), 2) for pick in (min, max)]
    figures: dict[str, object] = {
        "total_ms": total,
        "stages_ms": stages,
        "spread_ms": spread,
        "peak_rss_mb": round(_peak_rss_mb(), 1),
        "objects": len(reconstruction.objects),
        "samples": len(reconstruction.samples),
        "hinges": len(reconstruction.map.hinges),
        "iterations": reconstruction.map.report.iterations,
        "image": [loaded.camera.width, loaded.camera.height],
        "spacing_m": config.mesh.spacing,
        "threads": torch.get_num_threads(),
        "device": str(reconstruction.map.device),
        "repeat": repeat,
        "machine": f"{platform.machine()} {platform.system()}, Python {platform.python_version()}",
    }
    print(f"{figures['objects']} objects, {figures['threads']} threads, medians of {repeat} runs")
    for stage, ms in stages.items():
        print(f"  {stage:8} {ms:8.1f} ms" + ("  (not in the total)" if stage == "load" else ""))
    print(f"  {'total':8} {total:8.1f} ms  ({spread[0]:.0f}-{spread[1]:.0f})")
    print(f"  peak memory {figures['peak_rss_mb']:.0f} MB")
    write_json(figures, json)


def _peak_rss_mb() -> float:
    """Largest resident set of this process so far [MB]."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak / 1e3
