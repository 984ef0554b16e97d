"""`contramap demo`: simulate a scene, map it, measure it against the truth, and show all of it."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro

from reconstruction.config import PresetName
from reconstruction.config import preset as make_preset
from tools.map_frame import print_summary
from tools.options import write_json

if TYPE_CHECKING:
    from trimesh import Trimesh

    from reconstruction.result import Reconstruction


def demo(
    *,
    out: Path = Path("demo_out"),
    seed: int = 0,
    objects: str = "auto",
    ycb: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    preset: PresetName = "tabletop",
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Simulate a tabletop scene, map its first view, and compare the meshes with the truth.

    Example: contramap demo --out demo_out

    Args:
        out: Folder for the scene (OUT/scene_0000) and the result (OUT/result); older demos are replaced.
        seed: Which scene.
        objects: ycb (real scans), builtin, or auto: scans where found.
        ycb: Folder of YCB scans; otherwise YCB_DIR, ../shared/data/ycb and the download folder are tried.
        preset: tabletop or paper.
        json: Also write the figures to this file.
    """
    from perception.frame_io import load_frame
    from reconstruction import reconstruct, save_reconstruction
    from reconstruction.files.result_folder import check_output
    from sim_scenes.dataset import generate
    from sim_scenes.truth import load_truth

    config = make_preset(preset)
    check_output(out / "result", overwrite=True)
    print("simulating a scene ...")
    shutil.rmtree(out / "scene_0000", ignore_errors=True)
    (scene,) = generate(out, 1, seed, objects, ycb, views=1, progress=True)
    truth = load_truth(scene, ycb)
    print(f"mapping {len(truth.meshes)} {truth.objects[0].source} objects ...")
    reconstruction = reconstruct(load_frame(scene), config, seed)
    save_reconstruction(reconstruction, out / "result", overwrite=True, truth=truth.meshes, recording=True)
    print_summary(reconstruction)
    figures = compare(reconstruction, truth.meshes, np.random.default_rng(seed))
    _print_comparison(figures)
    write_json({"objects": figures, "timings_ms": reconstruction.timings_ms}, json)
    print(f"\nresult: {out / 'result'}   picture: {out / 'result' / 'overview.png'}")
    print(f"open the recording with: contramap view {out / 'result'}")


def compare(
    reconstruction: Reconstruction, truth: dict[int, Trimesh], rng: np.random.Generator
) -> list[dict[str, Any]]:
    """IoU (5 mm lattice), Chamfer distance [mm] and mean uncertainty of each true object; None: no mesh."""
    from reconstruction.metrics import chamfer

    found = {item.label: item for item in reconstruction.objects}
    rows: list[dict[str, Any]] = []
    for label, mesh in truth.items():
        row: dict[str, Any] = {"label": label, "name": reconstruction.frame.name_of(label), "iou": 0.0}
        row |= {"chamfer_mm": None, "mean_uncertainty": None}
        if item := found.get(label):
            row["iou"] = mesh_iou(item.mesh, mesh)
            row["chamfer_mm"] = 1e3 * chamfer(item.mesh, mesh, rng)
            row["mean_uncertainty"] = item.mean_uncertainty
        rows.append(row)
    return rows


def mesh_iou(predicted: Trimesh, true: Trimesh, spacing: float = 0.005) -> float:
    """IoU of two watertight meshes on a cubic lattice around both."""
    from reconstruction.metrics import grid_around, inside, iou_on_grid

    low = np.minimum(predicted.bounds[0], true.bounds[0])
    high = np.maximum(predicted.bounds[1], true.bounds[1])
    points = grid_around((low + high) / 2, float((high - low).max()) + spacing, spacing)
    return iou_on_grid(inside(predicted, points), true, points)


def _print_comparison(rows: list[dict[str, Any]]) -> None:
    print(f"\n{'label':>5}  {'name':28} {'IoU':>5}  Chamfer [mm]  mean uncertainty")
    mapped = [row for row in rows if row["chamfer_mm"] is not None]
    mean = {key: np.mean([row[key] for row in mapped]) for key in ("chamfer_mm", "mean_uncertainty")}
    mean |= {"label": "", "name": "mean", "iou": np.mean([row["iou"] for row in rows])}
    for row in [*mapped, mean]:
        print(
            f"{row['label']:>5}  {row['name']:28.28} {row['iou']:5.2f}  {row['chamfer_mm']:12.1f}"
            f"  {row['mean_uncertainty']:16.2f}"
        )
    for row in rows:
        if row not in mapped:
            print(f"missing: {row['label']} {row['name']}")
