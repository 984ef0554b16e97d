"""`contramap semantic SCAN... --out DIR`: labelled scans to a map in tiles and labelled voxels."""

from __future__ import annotations

import json as json_text
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from mapping.errors import ConfigError, DataError
from tools.options import write_json

if TYPE_CHECKING:
    import numpy as np

    from tools.semantic.tiles import Job

Metres = tyro.conf.arg(metavar="M")


def semantic(
    scans: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="SCAN")],
    *,
    out: Path,
    voxel: Annotated[float, Metres] = 0.2,
    tile: Annotated[float, Metres] = 60.0,
    overlap: Annotated[float, Metres] = 5.0,
    query: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    rrd: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    steps: int = 100,
    tolerance: float | None = None,
    workers: int = 1,
    engine: Literal["local", "ray"] = "local",
    seed: int = 0,
    overwrite: bool = False,
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Map labelled scans: classes, how doubtful each label is, and p(uncertain) anywhere.

    The map is made in tiles that are fitted alone and blended. Writes semantic.json (classes, settings,
    figures), tiles/ (a map each), voxels.zarr (label, its doubt, and uncertain, that is not observed; a chunk
    a tile), cloud.ply (observed voxels, coloured by class) and map.png (seen from above). A command that was
    cut off goes on where it stopped.

    Example: contramap semantic sequences/00 --out street --query points.npy --rrd street.rrd

    Args:
        scans: SemanticKITTI sequences or .bin scans, labelled clouds (.npz, .ply, .las, .laz), meshes (.npz).
        out: Folder for the files; one with other scans or settings in it needs --overwrite.
        voxel: Size of a voxel [m].
        tile: Side of a tile [m].
        overlap: Tiles also learn from points this far beyond them [m], and are blended there.
        query: Points (N, 3) [m] in a .npy file; probabilities, labels and doubts go to query.npz.
        rrd: Also write a rerun recording, the map growing scan by scan.
        steps: Steps of a tile's fit. They depend on what is near alone: away from seams tiles have one
            tile's probabilities.
        tolerance: Instead, quasi-Newton steps until one lowers the mean loss [nats] by less; at 4e-4 in half
            the time, but tiles have one tile's labels and not its probabilities.
        workers: Processes that fit tiles.
        engine: local processes, or ray (a cluster; --out must lie where every node can reach it).
        seed: Same seed, same files, whatever the number of workers.
        overwrite: Replace what is in the folder.
        json: Also write the figures to this file.
    """
    for name, value in (("voxel", voxel), ("tile", tile), ("overlap", overlap), ("workers", workers)):
        if not value > 0:
            raise ConfigError(f"--{name} must be > 0, got {value}")
    if tolerance is not None and not tolerance > 0:
        raise ConfigError(f"--tolerance must be > 0, got {tolerance}")
    if steps < 1:
        raise ConfigError(f"--steps must be at least 1, got {steps}")
    if not scans:
        raise ConfigError("name at least one SCAN: a sequence folder, a .bin, .npz, .ply, .las or .laz file")
    asked = _queries(query)
    figures = map_scans(
        scans, out, voxel, tile, overlap, asked, rrd, workers, engine, seed, overwrite, steps, tolerance
    )
    write_json(figures, json)
    print(
        f"{figures['points']} points of {figures['scans']} scans, {figures['tiles']} tiles: "
        f"fit {figures['fit_s']:.1f} s, voxels {figures['voxels_s']:.1f} s"
    )
    print(f"map: {out}")


def map_scans(
    scans: tuple[Path, ...],
    out: Path,
    voxel: float = 0.2,
    tile: float = 60.0,
    overlap: float = 5.0,
    query: np.ndarray | None = None,
    rrd: Path | None = None,
    workers: int = 1,
    engine: str = "local",
    seed: int = 0,
    overwrite: bool = False,
    steps: int = 100,
    tolerance: float | None = None,
) -> dict[str, Any]:
    """The command's work; returns its figures. Raises ConfigError or DataError for bad input."""
    import numpy as np

    from mapping.multiscale import MultiscaleConfig, Whole
    from tools.semantic.inputs import read_scans
    from tools.semantic.pictures import draw_above, record_scans, write_cloud
    from tools.semantic.queries import write_answers
    from tools.semantic.tiles import Job, create_store, fitted_so, plan_tiles
    from tools.semantic.workers import make_tiles

    clouds = read_scans(scans, seed)
    names = clouds[0].names
    if len(names) >= 255:
        raise DataError(f"{len(names)} classes; a voxel's label has room for 254")
    X = np.concatenate([cloud.points for cloud in clouds]).astype(np.float32)
    y = np.concatenate([cloud.labels for cloud in clouds])
    config = fitted_so(MultiscaleConfig(), steps, tolerance)
    whole = Whole.of(X, y, len(names), config)
    plan = plan_tiles(X, voxel, tile, overlap)
    job = Job(out, plan, config, whole, seed)
    _prepare(job, X, y, overwrite)
    create_store(job, names)
    tiles, seconds = list(plan.tiles()), make_tiles(job, workers, engine)
    skipped: dict[str, int] = {}
    for cloud in clouds:
        for reason, count in cloud.skipped.items():
            skipped[reason] = skipped.get(reason, 0) + count
    figures = {
        "classes": list(names),
        "scans": len(clouds),
        "points": len(X),
        "skipped": skipped,
        "wrong_label_share": whole.wrong,
        "tiles": len(tiles),
        "voxels": list(plan.counts),
        "voxel_m": voxel,
        "origin_m": list(plan.low),
        **seconds,
        "seed": seed,
        "config": asdict(config),
    }
    write_json(figures, out / "semantic.json")
    write_cloud(out, names)
    draw_above(out, names)
    if rrd is not None:
        record_scans(clouds, out, rrd)
    if query is not None:
        write_answers(job, tiles, query, names, out / "query.npz")
    return figures


def _prepare(job: Job, X: np.ndarray, y: np.ndarray, overwrite: bool) -> None:
    """The folder with the points the workers read; what was made of other points or settings is refused."""
    import hashlib
    import shutil

    import numpy as np

    from mapping.files import temporary_beside, write_atomically
    from reconstruction.files.output_folder import entries
    from tools.runs.kept import read_kept

    content = [X.tobytes(), y.tobytes(), repr((job.plan, job.config, job.seed)).encode()]
    print_of_all = hashlib.sha256(b"".join(content)).hexdigest()
    known = job.folder / "run.json"
    if job.folder.exists() and (not job.folder.is_dir() or entries(job.folder)):
        kept = read_kept(known, ("fingerprint",))
        if kept is None:
            raise ConfigError(
                f"{job.folder} holds other files than a run's of this command; choose another --out"
            )
        same = kept["fingerprint"] == print_of_all
        if not same and not overwrite:
            raise ConfigError(
                f"{job.folder} holds other files than this run's; choose another --out or add --overwrite"
            )
        if not same or overwrite:
            for name in ("tiles", "voxels.zarr"):
                shutil.rmtree(job.folder / name, ignore_errors=True)
    job.folder.mkdir(parents=True, exist_ok=True)
    # First, so that a run that is killed from here on is gone on with.
    write_atomically(known, (json_text.dumps({"fingerprint": print_of_all}) + "\n").encode())
    (job.folder / "tiles").mkdir(exist_ok=True)
    for name, array in (("points.npy", X), ("labels.npy", y.astype(np.uint8))):
        with temporary_beside(job.folder / name) as partial, partial.open("wb") as file:
            np.save(file, array)


def _queries(path: Path | None) -> np.ndarray | None:
    """The points to ask for, checked before anything is mapped."""
    if path is None:
        return None
    import numpy as np

    if not path.is_file():
        raise DataError(f"{path}: no such file; --query wants points (N, 3) written by numpy.save")
    try:
        X = np.load(path, allow_pickle=False)
    except (ValueError, OSError, EOFError) as error:
        raise DataError(f"{path}: not a readable .npy file ({error})") from error
    if X.ndim != 2 or X.shape[1] != 3 or X.dtype.kind not in "iuf" or not np.isfinite(X).all():
        raise DataError(f"{path}: --query wants finite points (N, 3), got {X.shape} {X.dtype}")
    return X.astype(np.float64)
