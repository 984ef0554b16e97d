"""`contramap benchmark grasps`: do planned grasps hold? A stopped run goes on where it was."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from tools.grasping.job import GraspJob

DEFAULT_CONDITIONS = ("truth", "raw", "tsdf", "contramap", "contramap-unsure")
"""All but V-PRISM, which takes ten times as long, and those that need a network's weights."""
SHEET_COLUMNS = 3


def grasps(
    *,
    out: Path,
    scenes: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    objects: tuple[str, ...] = ("auto",),
    arrangements: tuple[str, ...] = ("packed", "pile"),
    rounds: int = 10,
    conditions: tuple[str, ...] = DEFAULT_CONDITIONS,
    strict: bool = False,
    part: str = "held-out",
    ycb: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    vgn: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    seed: int = 0,
    workers: int = 1,
    pictures: int = 1,
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Plan grasps on shapes from one view, try them in physics, and count what is held.

    Each round puts five objects on a table; a free parallel-jaw hand (0.08 m) takes them away one by one,
    until the table is empty, two attempts fail in a row, or ten were made. What touches the hand on its way
    in is a failure; an object must stay in the hand while it is lifted by 10 cm. Results are kept round by
    round below OUT/runs: a stopped run goes on, and more --rounds add to it. Needs the extra `sim`.
    Example: contramap benchmark grasps --out grasps --objects ycb --rounds 10 --json grasps.json
    Example: contramap benchmark grasps --scenes scenes100 --out grasps --conditions contramap tsdf

    Args:
        out: Folder for runs, grasps.json, grasps.md and pictures.
        scenes: Folder made by `contramap scenes`: rounds begin as its scenes do, instead of with --objects.
        objects: ycb, builtin, figures, auto (scans where found), or folders of closed meshes in metres.
        arrangements: packed (upright, side by side) and pile (dropped on a heap).
        rounds: Rounds for each of --objects and --arrangements; with --scenes the most scenes played.
        conditions: truth, raw, tsdf, vprism, contramap, contramap-unsure (unsure space costs score); with
            --vgn also vgn-raw, vgn-contramap and vgn-truth.
        strict: Lift by 20 cm and shake for two seconds.
        part: Of a folder's objects: all, train or held-out, by name.
        ycb: Folder of YCB scans; otherwise where scans are looked for.
        vgn: Weights of the grasp network VGN (assets/models/vgn_conv.pth of ethz-asl/vgn).
        seed: Seed of rounds and planners.
        workers: Rounds at a time, each in a process of one thread.
        pictures: Rounds of each kind whose attempts are drawn.
        json: Also write the figures to this file.
    """
    from mapping.errors import ConfigError
    from tools.grasping.job import Objects
    from tools.grasping.play import condition
    from tools.grasping.rounds import ARRANGEMENTS

    names = tuple(dict.fromkeys(conditions))
    for name in names:
        if condition(name).planner == "vgn" and vgn is None:
            raise ConfigError(f"condition {name} needs the weights of VGN: --vgn FILE")
    if vgn is not None:
        from tools.grasping.vgn_network import load_network

        load_network(vgn)
    if wrong := set(arrangements) - set(ARRANGEMENTS):
        raise ConfigError(f"unknown arrangement {wrong.pop()!r}; valid: {', '.join(ARRANGEMENTS)}")
    if rounds < 1 or workers < 1 or seed < 0:
        raise ConfigError(
            f"--rounds and --workers must be at least 1 and --seed 0, got {rounds}, {workers}, {seed}"
        )
    if scenes is not None:
        from tools.evaluation.command import find_scenes

        kinds = [{"scene": folder} for folder in find_scenes(scenes, rounds)]
    else:
        sources = [Objects(source, ycb, part) for source in dict.fromkeys(objects)]
        kinds = [
            {"objects": source, "arrangement": arrangement, "index": index}
            for index, source, arrangement in product(range(rounds), sources, dict.fromkeys(arrangements))
        ]
    drawn = pictures if scenes is not None else pictures * len(sources) * len(set(arrangements))
    jobs = [
        _job(out, names, seed, strict, kind, number < drawn, ycb, vgn) for number, kind in enumerate(kinds)
    ]
    failures = _run(jobs, workers)
    _finish(jobs, failures, json)


def _job(
    out: Path,
    names: tuple[str, ...],
    seed: int,
    strict: bool,
    kind: dict,
    pictures: bool,
    ycb: Path | None,
    vgn: Path | None,
) -> GraspJob:
    from tools.grasping.job import GraspJob

    return GraspJob(out, names, seed, strict, pictures=pictures, ycb_dir=ycb, vgn=vgn, **kind)


def _run(jobs: list[GraspJob], workers: int) -> list[dict[str, str]]:
    """Play what is missing, with a progress bar; returns what failed."""
    from tqdm import tqdm

    from tools.grasping.job import run_round
    from tools.runs.workers import CRASHED, run_in_workers

    todo = [job for job in jobs if job.missing]
    if len(todo) < len(jobs):
        print(f"{len(jobs) - len(todo)} of {len(jobs)} rounds are done already")
    failures: list[dict[str, str]] = []
    with tqdm(total=len(todo), desc="rounds", unit="round", smoothing=0.1) as bar:
        for done in run_in_workers(run_round, todo, workers):
            if done.result is None:
                error = CRASHED if done.error is None else f"{type(done.error).__name__}: {done.error}"
                failed = [{"round": done.task.name, "condition": "", "error": error}]
            else:
                failed = done.result
            for failure in failed:
                bar.write("failed: {round} {condition}: {error}".format(**failure))
            failures += failed
            bar.set_postfix_str(done.task.name)
            bar.update()
    return failures


def _finish(jobs: list[GraspJob], failures: list[dict[str, str]], json_file: Path | None) -> None:
    """Write grasps.json, grasps.md and the contact sheet from all kept results."""
    from mapping.errors import DataError
    from mapping.files import write_atomically
    from tools.grasping.figures import summarise
    from tools.grasping.pictures import contact_sheet
    from tools.grasping.table import tables
    from tools.options import write_json
    from tools.provenance import with_provenance
    from tools.runs.failures import RunsFailed

    out = jobs[0].out
    results = {
        name: [result for job in jobs if (result := job.kept(name)) is not None]
        for name in jobs[0].conditions
    }
    if not any(results.values()):
        reason = failures[0]["error"] if failures else "no round was played"
        raise DataError(f"{out}: nothing could be measured; first failure: {reason}")
    summary = {**summarise(results), "strict": jobs[0].strict, "seed": jobs[0].seed, "failures": failures}
    name = "grasps_strict" if jobs[0].strict else "grasps"
    write_json(summary, out / f"{name}.json")
    write_json(summary, json_file)
    text = tables(summary)
    title = "Grasps lifted by 20 cm and shaken" if jobs[0].strict else "Grasps lifted by 10 cm"
    write_atomically(out / f"{name}.md", with_provenance(title, "\n".join(text)))
    drawn = sorted((out / "pictures").glob("*.png")) if (out / "pictures").is_dir() else []
    if drawn:
        contact_sheet(drawn, SHEET_COLUMNS, out / "grasps.png")
    print(text[0])
    print(out / f"{name}.md")
    if failures:
        raise RunsFailed(
            f"{len(failures)} runs failed (first: {failures[0]['error']}); the tables are of the "
            "others, the same command tries them again"
        )
