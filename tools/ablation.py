"""`python -m tools.ablation SCENES --out DIR`: what each part of the tabletop preset is worth.

Runs through the evaluation's engine: results are kept scene by scene below DIR/runs, a stopped run goes on.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import tyro

from tools.exit_code import exit_code
from tools.options import write_json
from tools.provenance import provenance

DEFAULT = "contramap"
NOISE = ("occluded", "near", "everywhere")
PRIOR = ("learned", "none")
HINGES = {
    "5, 2.5, 1.25 cm, 6 mm on thin walls": "",
    "5, 2.5 and 1.25 cm": "thin_spacing=null",
    "5 and 2.5 cm": "thin_spacing=null,finest_distance=null",
    "5 and 3.5 cm": "thin_spacing=null,finest_distance=null,fine_spacing=0.035,fine_gamma=1020",
}
SURFACES = {
    "fused at 2.5 mm, unseen walls": "",
    "without round bodies": "mesh.fusion.round_bodies=false",
    "without cuboids": "mesh.fusion.cuboids=false",
    "without unseen walls": "mesh.fusion.unseen_walls=false",
    "not faired": "mesh.fusion.fair=0",
    "fused at 5 mm": "mesh.fusion.refine=1",
    "of the map alone": "mesh.fusion.enabled=false",
}
COLUMNS = {
    "iou": "IoU",
    "iou_2_5mm": "IoU 2.5 mm",
    "chamfer_5mm": "Chamfer [mm]",
    "agreement": "agreement",
    "early_rays": "early rays",
    "normal_deg": "normals [deg]",
    "creases_excess_per_m": "creases [1/m]",
    "handles": "handles",
    "handles_right": "handles right",
    "wall_excess_mm": "walls [mm]",
    "occlusion_auroc": "occlusion AUROC",
    "error_auroc": "error AUROC",
    "aurc": "AURC",
}
DIGITS = {
    "chamfer_5mm": 2,
    "aurc": 5,
    "normal_deg": 1,
    "creases_excess_per_m": 1,
    "handles": 2,
    "wall_excess_mm": 1,
}


def variant(
    noise: str = "occluded", prior: str = "learned", hinges: str = "", pairs: bool = True, surface: str = ""
) -> str:
    """The method name of the preset with some parts changed."""
    settings = [
        f"noise={noise}" if noise != "occluded" else "",
        f"prior={prior}" if prior != "learned" else "",
        hinges,
        "pairs=false" if not pairs else "",
        surface,
    ]
    text = ",".join(setting for setting in settings if setting)
    return f"{DEFAULT}:{text}" if text else DEFAULT


def single_factors() -> list[tuple[str, str, str]]:
    """(factor, level, method) of the preset with one part changed at a time; each factor's default first."""
    return [
        *(("noise", level, variant(noise=level)) for level in NOISE),
        *(("prior", level, variant(prior=level)) for level in PRIOR),
        *(("hinge points", level, variant(hinges=setting)) for level, setting in HINGES.items()),
        *(("surface pairs", level, variant(pairs=on)) for level, on in (("on", True), ("off", False))),
        *(("surface", level, variant(surface=setting)) for level, setting in SURFACES.items()),
    ]


def two_factors() -> list[tuple[str, str, str]]:
    """(noise, prior, method) for all pairs of levels."""
    return [(noise, prior, variant(noise, prior)) for noise in NOISE for prior in PRIOR]


def ablation(
    scenes: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SCENES")],
    *,
    out: Path,
    limit: int | None = 20,
    seeds: tuple[int, ...] = (0,),
    workers: int = 1,
    threads: int = 1,
    ycb: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    parts: tuple[str, ...] = (),
) -> None:
    """Measure ContraMap with parts of the tabletop preset changed or taken away.

    Args:
        scenes: Folder made by `contramap scenes`.
        out: Folder for ablation.md, ablation.json and the kept results.
        limit: Only the first scenes.
        seeds: Seeds of the samples.
        workers: Jobs at a time.
        threads: Threads of each job.
        ycb: Folder of YCB scans; otherwise where the scenes were made from, or where scans are looked for.
        parts: Only these, of noise, prior, "hinge points", "surface pairs", surface; by default all, and
            noise with prior.
    """
    from mapping.errors import ConfigError, DataError
    from mapping.files import write_atomically
    from tools.evaluation.command import check_same_scenes, find_scenes, run_jobs
    from tools.evaluation.job import Job, Run
    from tools.evaluation.summary import read_results, summarise

    known = list(dict.fromkeys(part for part, *_ in single_factors()))
    if unknown := sorted(set(parts) - set(known)):
        raise ConfigError(f"parts: {unknown[0]!r} is none; valid: {', '.join(known)}")
    chosen = [row for row in single_factors() if not parts or row[0] in parts]
    names = tuple(dict.fromkeys(name for *_, name in (*chosen, *(() if parts else two_factors()))))
    jobs = [Job(folder, seeds, names, out, ycb, threads) for folder in find_scenes(scenes, limit)]
    check_same_scenes(jobs)
    failures = run_jobs(jobs, "local", workers, None)
    files = [job.result_file(Run(seed, name)) for name in names for seed in seeds for job in jobs]
    results = read_results([path for path in files if path.is_file()])
    if not results:
        raise DataError(f"{out}: nothing could be measured; first failure: {failures[0]['error']}")
    summary = summarise(results)
    write_json({**summary, "failures": failures}, out / "ablation.json")
    text = "\n\n".join([provenance(), *tables(summary["methods"])]) + "\n"
    write_atomically(out / "ablation.md", text.encode())
    print(text)


def tables(methods: dict[str, Any]) -> list[str]:
    """Both tables as markdown, from the summary's entries by method; variants that failed are left out."""
    from tools.markdown import markdown_table

    found = []
    crossed = [row for row in two_factors() if all(name in methods for *_, name in two_factors())]
    for names, rows in ((("part", "level"), single_factors()), (("noise", "prior"), crossed)):
        header = [*names, *COLUMNS.values(), "fit + mesh 15 mm, processor [s]"]
        cells = [[*labels, *_cells(methods[name])] for *labels, name in rows if name in methods]
        if cells:
            found.append(markdown_table([header, *cells]).rstrip())
    return found


def _cells(entry: dict[str, Any]) -> list[str]:
    values = [f"{entry[key]['mean']:.{DIGITS.get(key, 3)}f}" if key in entry else "" for key in COLUMNS]
    return [*values, f"{entry['fit_cpu_s'] + entry['mesh_cpu_s']:.3f}"]


if __name__ == "__main__":
    sys.exit(exit_code("ablation", lambda: tyro.cli(ablation)))
