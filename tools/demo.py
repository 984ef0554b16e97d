"""`contramap demo`: simulate a scene, map it, measure it against the truth, and show all of it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro

from reconstruction.config import PresetName
from reconstruction.config import preset as make_preset
from tools.demo_folder import clear_scene, remember_scene
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
        seed: Which scene; the shipped one is always the same.
        objects: ycb (real scans), builtin, shipped (a small scene that comes with the package and needs no
            simulator), or auto: scans where found; shipped where pybullet is missing.
        ycb: Folder of YCB scans; otherwise YCB_DIR, ../shared/data/ycb and the download folder are tried.
        preset: tabletop or paper.
        json: Also write the figures to this file.
    """
    from perception.frame_io import load_frame
    from reconstruction import reconstruct, save_reconstruction
    from reconstruction.files.result_folder import check_output
    from sim_scenes.truth import load_truth

    config = make_preset(preset)
    check_output(out / "result", overwrite=True)
    clear_scene(out, "scene_0000")
    scene = _scene(out, seed, objects, ycb)
    remember_scene(out, scene)
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


def _scene(out: Path, seed: int, objects: str, ycb: Path | None) -> Path:
    """A simulated scene below `out`, or the shipped one where that is asked for or pybullet is missing."""
    from importlib.util import find_spec

    if objects == "auto" and find_spec("pybullet") is None:
        print(
            "No pybullet here (it has wheels for Python 3.10 and 3.11), so no simulator: "
            "taking the scene that ships with the package."
        )
        objects = "shipped"
    if objects == "shipped":
        from sim_scenes.shipped_scene import unpack

        return unpack(out / "scene_0000")
    from sim_scenes.dataset import generate

    print("simulating a scene ...")
    return generate(out, 1, seed, objects, ycb, views=1, progress=True)[0]


def compare(
    reconstruction: Reconstruction, truth: dict[int, Trimesh], rng: np.random.Generator
) -> list[dict[str, Any]]:
    """IoU (5 mm lattice), Chamfer distance [mm] and mean uncertainty of each true object; None: no mesh."""
    from reconstruction.metrics import chamfer, mesh_iou

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
