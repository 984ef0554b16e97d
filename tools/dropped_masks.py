"""What a map says of a thing whose mask is missing: one label dropped at a time, its inside asked for.

`python -m tools.dropped_masks --scenes SCENES --real ../shared/data/real_rgbd --json dropped.json` prints,
over all drops, the share of the dropped objects' insides that is called free with p(uncertain) < 0.3, and the
share of measured points that are called free. `--first` and `--limit` make it in pieces; `--add a.json b.json
--table FILE` writes the table of all of them.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro

from mapping.errors import ConfigError, DataError, FrameError
from mapping.files import write_atomically
from perception.camera import invert_rigid, transform
from perception.frame import Frame
from tools.exit_code import exit_code
from tools.pieces import earlier, named_pieces
from tools.provenance import provenance, with_provenance

if TYPE_CHECKING:
    from reconstruction.solid import Solid

LEAST_PIXELS = 200
"""Labels that cover fewer pixels are not dropped."""
INSIDE_POINTS = 2000
"""Points asked for within each dropped object."""
SURE = 0.3
"""What is called empty with less p(uncertain) than this is called free."""
MEASURED_STEP = 7
"""One of so many measured pixels is asked for."""
REACH = 0.16
"""Measured points within this distance of the labelled objects are asked for [m]."""


@dataclass(frozen=True)
class Drop:
    """One frame and one of its labels; solid: the inside of what it names [world frame], as far as known."""

    name: str
    frame: Frame
    label: int
    solid: Solid


@dataclass(frozen=True)
class Part:
    """Which frames of each kind are looked at, and how many of their labels are dropped."""

    first: int
    limit: int
    drops: int

    def of(self, frames: list[Any]) -> list[Any]:
        """The frames of this part."""
        return frames[self.first : self.first + self.limit]

    def labels(self, frame: Frame) -> list[int]:
        """The labels to drop, spread evenly over those that are large enough."""
        large = _large(frame)
        count = min(self.drops, len(large))
        return [large[index * len(large) // count] for index in range(count)]


def main(
    scenes: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    real: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    ycb: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    first: int = 0,
    limit: int = 1000,
    drops: int = 1000,
    add: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="FILE")] = (),
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    table: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Drop one mask at a time and count what is called free.

    Args:
        scenes: Scenes with truth, as `contramap scenes` makes them.
        real: Published real frames; the inside of an object is that of its own mesh from the whole frame.
        ycb: Folder of YCB scans, for scenes made of them.
        first: Frames of each kind passed over before the first that is looked at.
        limit: Frames of each kind looked at, at most.
        drops: Labels dropped of each frame, at most, spread evenly over its labels.
        add: Files written by --json before, whose drops are added to the table.
        json: Also write the figures to this file.
        table: Also write them as a markdown table to this file.
    """
    from tqdm import tqdm

    from tools.options import write_json

    if scenes is None and real is None and not add:
        raise ConfigError("give --scenes DIR, --real DIR, or both, or --add FILE")
    if min(limit, drops) < 1 or first < 0:
        raise ConfigError(
            f"--limit and --drops are 1 or more, --first 0 or more; got {limit}, {drops}, {first}"
        )
    part = Part(first, limit, drops)
    rows, written_by = earlier(add)
    written_by += [provenance()] if scenes or real else []
    simulated = list(_simulated(scenes, ycb, part)) if scenes else []
    of_this_run = [*simulated, *(_real(real, part) if real else ())]
    for number, drop in enumerate(tqdm(of_this_run, desc="dropped masks", disable=not of_this_run)):
        row = judge(drop)
        if row is not None:
            rows.append({"kind": "simulated" if number < len(simulated) else "real", **row})
    if not rows:
        raise DataError("no frame has two labels of which one can be dropped")
    # Pieces may overlap: of two rows of one drop the later one counts.
    rows = list({(row["frame"], row["label"]): row for row in rows}.values())
    figures = {**summary(rows), "written_by": written_by, "rows": rows}
    for row in sorted(rows, key=lambda row: -row["inside_free"])[:10]:
        print(
            f"{row['frame']:32.32} {row['label']:>4}  inside free {row['inside_free']:.2%}  "
            f"measured free {row['measured_free']:.3%}"
        )
    inside, measured = figures["inside_free"], figures["measured_free"]
    print(
        f"{len(rows)} drops: inside called free {inside['mean']:.2%} on average, {inside['largest']:.2%} at "
        f"most; measured points called free {measured['mean']:.3%}, {measured['largest']:.3%} at most"
    )
    write_json(figures, json)
    if table is not None:
        write_atomically(
            table,
            with_provenance("What a map says of a thing whose mask is missing", markdown(rows, written_by)),
        )


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Mean and largest shares over rows of `judge`."""
    shares = {key: np.array([row[key] for row in rows]) for key in ("inside_free", "measured_free")}
    return {
        "drops": len(rows),
        **{key: {"mean": float(of.mean()), "largest": float(of.max())} for key, of in shares.items()},
        "over_1_percent": int((shares["inside_free"] > 0.01).sum()),
        "inside_other": float(np.mean([row["inside_other"] for row in rows])),
    }


def markdown(rows: list[dict[str, Any]], written_by: list[str]) -> str:
    """Two tables: all drops of each kind, and the ten worst; written_by: one line a piece."""
    lines = [
        *named_pieces(written_by),
        f"One label at a time is removed. Free: called empty with p(uncertain) < {SURE:g}.",
        "",
        "| kind | frames | drops | inside free, mean | largest | drops over 1 % | measured free, mean "
        "| largest | inside called other obstacle |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for kind in dict.fromkeys(row["kind"] for row in rows):
        of_kind = [row for row in rows if row["kind"] == kind]
        of = summary(of_kind)
        inside, measured = of["inside_free"], of["measured_free"]
        frames = len({row["frame"] for row in of_kind})
        lines.append(
            f"| {kind} | {frames} | {of['drops']} | {inside['mean']:.2%} | {inside['largest']:.2%} | "
            f"{of['over_1_percent']} | {measured['mean']:.3%} | {measured['largest']:.3%} | "
            f"{of['inside_other']:.0%} |"
        )
    lines += [
        "",
        "The ten worst:",
        "",
        "| frame | label | inside free | measured free |",
        "| --- | --- | --- | --- |",
    ]
    for row in sorted(rows, key=lambda row: -row["inside_free"])[:10]:
        lines.append(
            f"| {row['frame']} | {row['label']} | {row['inside_free']:.2%} | {row['measured_free']:.3%} |"
        )
    return "\n".join(lines)


def judge(drop: Drop) -> dict[str, Any] | None:
    """Shares of the dropped object's inside, and of measured points, that are called free; None where no
    object is left to map."""
    from reconstruction.config import TABLETOP
    from reconstruction.fitted_scene import FittedScene
    from reconstruction.query import ask

    frame = drop.frame
    assert frame.labels is not None
    labels = np.where(frame.labels == drop.label, 0, frame.labels).astype(np.uint16)
    if not labels.any():
        return None
    scene = FittedScene.of(replace(frame, labels=labels), TABLETOP)
    try:
        observation = scene.observation
    except FrameError:
        return None
    T_table_world = observation.T_table_camera @ invert_rigid(frame.camera.T_world_camera)
    low, high = drop.solid.mesh.bounds
    points = np.random.default_rng(drop.label).uniform(low, high, (20 * INSIDE_POINTS, 3))
    inside = transform(T_table_world, points[drop.solid.inside(points)][:INSIDE_POINTS]).astype(np.float32)
    measured = frame.camera.back_project(frame.depth)[np.isfinite(frame.depth)][::MEASURED_STEP]
    measured = transform(observation.T_table_camera, measured)
    measured = measured[observation.near_objects(measured, REACH)]
    if len(inside) == 0:
        return None
    found = [ask(scene.map, observation, scene.space, scene.floor, part) for part in (inside, measured)]
    free = [float((answer.free & (answer.uncertainty < SURE)).mean()) for answer in found]
    return {
        "frame": drop.name,
        "label": drop.label,
        "inside_free": free[0],
        "inside_other": float((found[0].label == -2).mean()),
        "measured_free": free[1],
    }


def _simulated(scenes: Path, ycb: Path | None, part: Part) -> Iterator[Drop]:
    from perception import load_frame
    from reconstruction.solid import Solid
    from sim_scenes.truth import load_truth

    for folder in part.of(sorted(path.parent for path in scenes.glob("*/truth.json"))):
        truth = load_truth(folder, ycb)
        frame = load_frame(truth.views[0])
        for label in part.labels(frame):
            if label in truth.meshes:
                yield Drop(f"{scenes.name}/{folder.name}", frame, label, Solid(truth.meshes[label]))


def _real(data: Path, part: Part) -> Iterator[Drop]:
    from reconstruction import reconstruct
    from reconstruction.solid import Solid
    from tools.real_frames import load_clutter_frames, load_real_frames

    frames = [*load_real_frames(data), *load_clutter_frames(data)]
    several = [real for real in frames if real.frame.labels is not None and len(_large(real.frame)) > 1]
    for real in part.of(several):
        whole = {item.label: item for item in reconstruct(real.frame).objects}
        for label in part.labels(real.frame):
            if label in whole:
                yield Drop(real.name, real.frame, label, Solid(whole[label].mesh))


def _large(frame: Frame) -> list[int]:
    """Labels of enough pixels to be dropped."""
    assert frame.labels is not None
    count = np.bincount(frame.labels.reshape(-1))
    return [int(label) for label in np.flatnonzero(count >= LEAST_PIXELS) if label > 0]


if __name__ == "__main__":
    sys.exit(exit_code("dropped_masks", lambda: tyro.cli(main)))
