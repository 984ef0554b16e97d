"""`contramap evaluate`: methods side by side on scenes with known truth; a stopped run goes on."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from tools.evaluation.job import Job

DEFAULT_METHODS = ("contramap", "contramap-paper", "hilbert", "tsdf")
"""The fast methods."""


def evaluate(
    scenes: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="SCENES")] = None,
    *,
    out: Path,
    bop: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    methods: tuple[str, ...] = DEFAULT_METHODS,
    seeds: tuple[int, ...] = (0, 1, 2),
    limit: int | None = None,
    engine: Literal["local", "ray"] = "local",
    workers: int = 1,
    threads: int = 1,
    ray_address: str | None = None,
    ycb: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    gallery: int = 4,
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Measure shapes, uncertainty and speed of several methods on the same scenes.

    Results are kept scene by scene below OUT/runs: a stopped evaluation goes on where it was.
    Example: contramap evaluate scenes100 --out evaluation --methods contramap contramap-paper vprism

    Args:
        scenes: Folder made by `contramap scenes`.
        out: Folder for results.jsonl, summary.json, table.md, figures and report.html.
        bop: Split folder of a data set in BOP's layout (such as ycbv/test), instead of SCENES.
        methods: contramap (preset tabletop), contramap-paper, hilbert, bayesian-hilbert, vprism,
            vprism-dense (no feature dropped: for its time), vprism-bound (alpha as the bound has it), tsdf.
        seeds: Seeds of every method's own sampling.
        limit: Only the first scenes.
        engine: local (processes of this machine) or ray (a cluster; needs the extra `cluster`).
        workers: Jobs at a time; the timings are honest for 1.
        threads: Threads of each job.
        ray_address: A running Ray cluster; without it a local one is started.
        ycb: Folder of YCB scans; otherwise where the scenes were made from, or where scans are looked for.
        gallery: Scenes shown in the report's gallery; 0 makes none.
        json: Also write the summary to this file.
    """
    from mapping.errors import ConfigError
    from tools.evaluation.job import Job
    from tools.evaluation.methods import method

    for name in methods:
        method(name)
    if (scenes is None) == (bop is None):
        raise ConfigError("give either SCENES or --bop DIR")
    if bop is not None:
        from tools.evaluation.bop_scenes import scenes_of_bop

        scenes = scenes_of_bop(bop, out / "bop_scenes", limit)
    assert scenes is not None
    folders = find_scenes(scenes, limit)
    unique = tuple(dict.fromkeys(methods))
    jobs = [Job(folder, seeds, unique, out, ycb, threads) for folder in folders]
    check_same_scenes(jobs)
    failures = run_jobs(jobs, engine, workers, ray_address)
    finish(jobs, failures, gallery, json)


def find_scenes(scenes: Path, limit: int | None) -> list[Path]:
    """Scene folders below a folder (or the folder itself), sorted. Raises DataError when there are none."""
    from mapping.errors import DataError
    from sim_scenes.truth import TRUTH_FILE

    if (scenes / TRUTH_FILE).is_file():
        return [scenes]
    # What a killed `contramap scenes` left is no scene; older versions named it scene_0000.<process>.tmp.
    found = sorted(
        path.parent
        for path in scenes.glob(f"*/{TRUTH_FILE}")
        if not path.parent.name.startswith(".") and path.parent.suffix != ".tmp"
    )[:limit]
    if not found:
        raise DataError(
            f"{scenes}: no scene (folder with {TRUTH_FILE}); `contramap scenes {scenes}` makes some"
        )
    return found


def check_same_scenes(jobs: list[Job]) -> None:
    """Raise ConfigError when results below the output folder came from other scenes of the same names."""
    from mapping.errors import ConfigError

    for job in jobs:
        for run in job.runs:
            kept = job.kept(run)
            if kept is not None and kept["fingerprint"] != job.fingerprint:
                raise ConfigError(
                    f"{job.result_file(run)} was measured on another scene called {job.scene.name}; "
                    "choose another --out"
                )


def run_jobs(jobs: list[Job], engine: str, workers: int, ray_address: str | None) -> list[dict[str, str]]:
    """Do what is missing of the jobs, with a progress bar; returns what failed."""
    from tqdm import tqdm

    from tools.evaluation.engine import run_local, run_ray

    todo = [job for job in jobs if job.missing()]
    if len(todo) < len(jobs):
        print(f"{len(jobs) - len(todo)} of {len(jobs)} scenes are done already")
    failures: list[dict[str, str]] = []
    with tqdm(total=len(todo), desc="scenes", unit="scene", smoothing=0.1) as bar:

        def finished(job: Job, failed: list[dict[str, str]]) -> None:
            failures.extend(failed)
            for failure in failed:
                bar.write("failed: {scene} seed {seed} {method}: {error}".format(**failure))
            bar.set_postfix_str(job.scene.name)
            bar.update(not job.missing() or bool(failed))

        if engine == "ray":
            run_ray(todo, workers, finished, ray_address)
        else:
            run_local(todo, workers, finished)
    return failures


def finish(jobs: list[Job], failures: list[dict[str, str]], gallery: int, json_file: Path | None) -> None:
    """Write results.jsonl, summary.json, table.md, figures and report.html from all kept results."""
    from mapping.errors import DataError
    from mapping.files import write_atomically
    from tools.evaluation.figures import write_figures
    from tools.evaluation.job import Run
    from tools.evaluation.report import write_report
    from tools.evaluation.summary import json_lines, summarise
    from tools.evaluation.table import all_tables
    from tools.options import write_json
    from tools.provenance import with_provenance
    from tools.runs.failures import RunsFailed

    out = jobs[0].out
    runs = [Run(seed, name) for name in jobs[0].methods for seed in jobs[0].seeds]
    kept = [job.kept(run) for run in runs for job in jobs]
    results = [result for result in kept if result is not None]
    if not results:
        reason = failures[0]["error"] if failures else "no job ran"
        raise DataError(f"{out}: nothing could be measured; first failure: {reason}")
    summary = {**summarise(results), "threads": jobs[0].threads, "failures": failures}
    write_json(summary, out / "summary.json")
    write_json(summary, json_file)
    write_atomically(out / "results.jsonl", json_lines(results).encode())
    tables = all_tables(summary)
    write_atomically(out / "table.md", with_provenance("Evaluation", "\n\n".join(tables)))
    figures = write_figures(results, out / "figures")
    picture = make_gallery(jobs, gallery)
    write_report(summary, figures, picture, out / "report.html")
    print("\n\n".join(tables[:3]))
    print(f"\n{out / 'report.html'}")
    if failures:
        raise RunsFailed(
            f"{len(failures)} of {len(kept)} runs failed (first: {failures[0]['error']}); tables are of the "
            f"others, {out / 'summary.json'} lists the failures, the same command tries them again"
        )


def make_gallery(jobs: list[Job], count: int) -> Path | None:
    """Draw the gallery of the first scenes, every method that was evaluated.

    Kept when it is newer than the results.
    """
    from tqdm import tqdm

    from tools.evaluation.gallery import pictures_of, write_gallery
    from tools.evaluation.job import Run
    from tools.runs.workers import run_in_workers

    names = jobs[0].methods
    path = jobs[0].out / "figures" / "gallery.png"
    needed = [Run(jobs[0].seeds[0], name) for name in names]
    shown = [job for job in jobs if all(job.kept(run) is not None for run in needed)][:count]
    if not shown:
        return None
    newest = max(job.result_file(run).stat().st_mtime for job in shown for run in needed)
    if path.is_file() and path.stat().st_mtime > newest:
        return path
    # In a worker like those that measured: same threads, and a crash leaves the tables standing.
    wanted_of = {job.scene: (job.scene, names, job.ycb_dir) for job in shown}
    pictures = run_in_workers(pictures_of, wanted_of.values(), 1, jobs[0].threads)
    rows = {}
    for done in tqdm(pictures, total=len(shown), desc="gallery"):
        if done.result is None:
            print(f"no pictures of {done.task[0].name}: {done.error or 'the worker process died'}")
        else:
            rows[done.task[0].name] = done.result
    if not rows:
        return None
    write_gallery(rows, path)
    return path
