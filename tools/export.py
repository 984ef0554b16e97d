"""`contramap export`: a result folder as the files that planners, physics engines and grasp networks read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from tools.options import write_json


def export(
    result: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RESULT")],
    *,
    format: tuple[str, ...],
    out: Path,
    density: float = 500.0,
    friction: float = 0.8,
    inflate: Annotated[float | None, tyro.conf.arg(metavar="P")] = None,
    cutter: Literal["halves", "coacd"] = "halves",
    workers: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    overwrite: bool = False,
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Write a result in planners' formats, one folder a format: --out/urdf, --out/moveit ...

    Example: contramap export result --format urdf mjcf moveit --out exports

    Args:
        result: Result folder of `contramap map`; nothing else is needed.
        format: obj, glb, urdf, mjcf, usd, sdf-field, moveit, curobo, contact-graspnet, gpd or vgn; several.
        out: Folder for the formats' folders.
        density: Mass per volume for masses and inertias [kg/m^3].
        friction: Friction coefficient of the objects.
        inflate: Collision shapes take in whatever is occupied with more than this probability, such as 0.05.
        cutter: What makes the first cuts into convex parts: halvings, or CoACD, which takes longer.
        workers: Processes that cut objects at a time; one a core by default. The files do not depend on it.
        overwrite: Replace older exports in --out.
        json: Also write parts, their error and times to this file.
    """
    from time import perf_counter

    from tqdm import tqdm

    from mapping.guarded_files import read_json
    from reconstruction.export.export_scene import ExportConfig, ExportScene
    from reconstruction.export.formats import STATEMENT, check_formats
    from reconstruction.export.formats import export as write_formats
    from reconstruction.files.result_folder import load_result

    check_formats(format)
    start = perf_counter()
    config = ExportConfig(density, friction, inflate, cutter=cutter, workers=workers)
    stored = load_result(result)
    with tqdm(desc="convex parts", total=len(stored.objects), disable=None, leave=False) as bar:
        scene = ExportScene(stored, config, bar.update)
        folders = write_formats(scene, format, out, overwrite)
    seconds = perf_counter() - start
    for folder in folders:
        print(folder)
    said = {folder.name: read_json(folder / STATEMENT) for folder in folders}
    parts = {name: statement["collision"] for name, statement in said.items() if "collision" in statement}
    for name, objects in parts.items():
        for key, of_one in objects.items():
            note = f"; {of_one['note']}" if "note" in of_one else ""
            print(
                f"{name} {key}: {of_one['parts']} convex parts, at most {of_one['missing_mm']} mm missing "
                f"and {of_one['excess_mm']} mm in excess{note}"
            )
    print(f"{len(folders)} formats of {len(stored.objects)} objects in {seconds:.1f} s")
    write_json({"objects": len(stored.objects), "seconds": round(seconds, 3), "collision": parts}, json)
