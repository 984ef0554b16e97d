"""`contramap benchmark serve`: what the service adds to the library's time, and what it takes."""

from __future__ import annotations

import tempfile
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from mapping.errors import ConfigError, DataError

if TYPE_CHECKING:
    from perception.frame import Frame as LoadedFrame
    from tools.serving.trial import Frame, Service

MAX_MB = 16.0
"""Largest message that the service tried here takes."""
SMALL_WIDTH = 160
"""Frames that are only counted are thinned out to about this many columns."""
ROWS = 10
"""Lines of the table of memory."""


def serve_benchmark(
    *,
    frame: Path,
    many: Annotated[Path | None, tyro.conf.arg(metavar="FRAME")] = None,
    frames: int = 1000,
    repeat: int = 15,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Time `contramap serve` against the library, and try it with killed clients and broken messages.

    The service runs in a process of its own. Needs the extra `serve`.
    Example: contramap benchmark serve --frame FRAME --out docs/results/serve.md

    Args:
        frame: Frame folder or .npz file that is timed.
        many: The frame that is sent again and again; by default the first one, thinned out.
        frames: Times that it is sent while its memory is watched.
        repeat: Frames of full size that are timed.
        out: Also write the tables to this Markdown file.
        json: Also write the figures to this file.
    """
    from mapping.files import write_atomically
    from perception.frame_io import load_frame
    from tools.options import write_json
    from tools.provenance import with_provenance
    from tools.serving.trial import running_service

    if frames < ROWS or repeat < 1:
        raise ConfigError(f"--frames must be at least {ROWS} and --repeat 1, got {frames} and {repeat}")
    fields = _fields(load_frame(frame))
    if many is None:
        small = _thinned(fields, max(1, fields["depth"].shape[1] // SMALL_WIDTH))
    else:
        small = _fields(load_frame(many))
    with running_service(MAX_MB) as service:
        figures = {"latency": _latency(service, fields, small, repeat), **_endurance(service, small, frames)}
    tables = _tables(figures)
    print(tables)
    write_json(figures, json)
    if out is not None:
        write_atomically(out, with_provenance("The service", tables))


def _fields(loaded: LoadedFrame) -> Frame:
    """A frame as a `map` request has it."""
    camera = loaded.camera
    fields = {"depth": loaded.depth, "K": camera.K, "T_world_camera": camera.T_world_camera}
    return fields if loaded.labels is None else {**fields, "labels": loaded.labels}


def _latency(service: Service, fields: Frame, small: Frame, repeat: int) -> list[dict[str, float]]:
    """Medians of `repeat` frames of full size and small, after two that warm up."""
    from tools.serving.client import Client
    from tools.serving.trial import timed_map

    client = Client(service.address, 120)
    rows = []
    for one in (fields, small):
        runs = [timed_map(client, one) for _ in range(repeat + 2)][2:]
        height, width = one["depth"].shape
        row = {"width": width, "height": height, **{k: median(run[k] for run in runs) for k in runs[0]}}
        row["worst_overhead_ms"] = max(run["overhead_ms"] for run in runs)
        rows.append({key: round(value, 1) for key, value in row.items()})
    return rows


def _endurance(service: Service, small: Frame, frames: int) -> dict[str, Any]:
    """Frames without end and trouble in between; the service must answer after each."""
    from tqdm import tqdm

    from tools.serving.client import Client
    from tools.serving.trial import timed_map, troubles

    client = Client(service.address, 120)
    overheads: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        kinds = troubles(service, small, int(MAX_MB * 1e6), Path(folder))
        count = dict.fromkeys(kinds, 0)
        for kind, make in kinds.items():  # once before memory is read: their buffers stay
            make()
            count[kind] += 1
        held = [{"frames": 0, **service.held()}]
        for number in tqdm(range(1, frames + 1), desc="frames"):
            overheads.append(timed_map(client, small)["overhead_ms"])
            if number % 10 == 0:
                kind = list(kinds)[number // 10 % len(kinds)]
                kinds[kind]()
                count[kind] += 1
                if not client.ask("ping")["ok"]:
                    raise DataError(f"the service does not answer after: {kind}")
            if number % (frames // ROWS) == 0:
                held.append({"frames": number, **service.held()})
    return {"troubles": count, "held": held, "overhead_ms_of_all": round(median(overheads), 2)}


def _thinned(fields: Frame, step: int) -> Frame:
    """Every `step`-th pixel of a frame."""
    K = fields["K"].copy()
    K[:2] /= step
    images = {
        key: value[::step, ::step].copy() for key, value in fields.items() if key in ("depth", "labels")
    }
    return {**fields, **images, "K": K}


def _tables(figures: dict[str, Any]) -> str:
    lines = ["| frame | library [ms] | client waits [ms] | between [ms] | worst |", "| --- " * 5 + "|"]
    for row in figures["latency"]:
        lines.append(
            f"| {row['width']:.0f}x{row['height']:.0f} | {row['library_ms']:.1f} | {row['waited_ms']:.1f} | "
            f"{row['overhead_ms']:.1f} | {row['worst_overhead_ms']:.1f} |"
        )
    lines += ["", "Medians; the library's time is that of the same frames, as `reconstruct` reports it.", ""]
    held = figures["held"]
    lines += ["| frames | " + " | ".join(key for key in held[0] if key != "frames") + " |"]
    lines += ["| --- " * len(held[0]) + "|"]
    lines += ["| " + " | ".join(f"{value:g}" for value in row.values()) + " |" for row in held]
    lines += ["", "In between, with the service answering after each:", ""]
    lines += [f"- {kind}: {count} times" for kind, count in figures["troubles"].items()]
    return "\n".join(lines)
