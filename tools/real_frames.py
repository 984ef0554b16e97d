"""Maps the published real sensor frames and measures them where the true mesh and pose are known.

`python -m tools.real_frames --data ../shared/data/real_rgbd --out real_out` writes a frame folder and a
result folder for each, and prints size, IoU and Chamfer distance beside the truth.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mapping.errors import DataError
from perception.frame import Frame
from tools.exit_code import exit_code

if TYPE_CHECKING:
    from trimesh import Trimesh

GRASPNET6 = "6dof_graspnet_demo"
POSECNN = "posecnn_pytorch_demo"
POSECNN_FRAMES = ("000000", "000002")
GRASPNET = "graspnet_example"
OSD = "osd"
OSD_UNIT = 1e-4
"""Metres a unit of depth in the frames of the Object Segmentation Database."""


@dataclass(frozen=True)
class RealFrame:
    """One real frame; poses: label -> (YCB id, T_camera_object (4, 4)) where a pose is known."""

    name: str
    frame: Frame
    poses: dict[int, tuple[str, np.ndarray]]


def load_real_frames(data: Path) -> list[RealFrame]:
    """All frames below a folder laid out as the SOURCES.json beside them says; raises DataError if absent."""
    if not (data / GRASPNET6).is_dir():
        raise DataError(f"{data}: no real frames here (wanted the folder {GRASPNET6})")
    meta = json.loads((data / GRASPNET6 / "meta.json").read_text())
    frames = [_single_object(data / GRASPNET6, name, entry) for name, entry in meta["frames"].items()]
    frames += [_clutter(data / POSECNN, name) for name in POSECNN_FRAMES]
    return [*frames, _unlabelled(data / GRASPNET)]


def load_clutter_frames(data: Path) -> list[RealFrame]:
    """The frames of the Object Segmentation Database below the same folder; none where it is absent."""
    found = []
    for path in sorted((data / OSD).glob("*.npz")):
        with np.load(path) as stored:
            depth = stored["depth"].astype(np.float32) * np.float32(OSD_UNIT)
            frame = Frame.from_arrays(depth, stored["K"], stored["labels"])
        found.append(RealFrame(f"{OSD}/{path.stem}", frame, {}))
    return found


def compare(real: RealFrame, result: Any, ycb: Path | None) -> list[dict[str, Any]]:
    """Size, watertightness and, where the truth is known, IoU and Chamfer distance of each object."""
    from reconstruction.metrics import chamfer, mesh_iou

    rows: list[dict[str, Any]] = []
    for item in result.objects:
        size = np.sort(item.extents)[::-1]
        row: dict[str, Any] = {"frame": real.name, "label": item.label, "name": item.name}
        row |= {"size_mm": (1e3 * size).round(1).tolist(), "watertight": item.watertight}
        row["mean_uncertainty"] = round(item.mean_uncertainty, 3)
        if (truth := _true_mesh(real, item.label, ycb)) is not None:
            from reconstruction.bounding import upright_box

            T_table_world = np.linalg.inv(result.T_world_table)
            vertices = truth.vertices @ T_table_world[:3, :3].T + T_table_world[:3, 3]
            row["true_size_mm"] = (1e3 * np.sort(upright_box(vertices)[1])[::-1]).round(1).tolist()
            row["iou"] = round(mesh_iou(item.mesh, truth), 3)
            row["chamfer_mm"] = round(1e3 * chamfer(item.mesh, truth, rng=np.random.default_rng(0)), 2)
        rows.append(row)
    return rows


def size_is_right(row: dict[str, Any]) -> bool:
    """Whether every side of the upright box is right to 25 % or 2 cm."""
    size, true = np.array(row["size_mm"]), np.array(row["true_size_mm"])
    return bool((np.abs(size - true) <= np.maximum(0.25 * true, 20)).all())


def _true_mesh(real: RealFrame, label: int, ycb: Path | None) -> Trimesh | None:
    if label not in real.poses or ycb is None:
        return None
    from sim_scenes.objects.ycb import list_models, load_ycb

    name, T = real.poses[label]
    if name not in list_models(ycb):
        return None
    mesh = load_ycb(ycb, name).mesh.copy()
    mesh.apply_transform(real.frame.camera.T_world_camera @ T)
    return mesh


def _single_object(folder: Path, name: str, entry: dict[str, Any]) -> RealFrame:
    from perception.frame_io import load_images

    title = entry.get("object", name)
    frame = load_images(
        folder / f"{name}-color.png",
        folder / f"{name}-depth.png",
        folder / f"{name}-mask.png",
        np.array(entry["K"]),
        1e-4,
        names={1: title, 255: title},
    )
    assert frame.labels is not None
    (label,) = set(np.unique(frame.labels).tolist()) - {0}
    poses = {label: (title, np.array(entry["T_cam_obj"]))} if "T_cam_obj" in entry else {}
    return RealFrame(f"{GRASPNET6}/{name}", frame, poses)


def _clutter(folder: Path, name: str) -> RealFrame:
    from perception.frame_io import load_images

    truth = json.loads((folder / "poses_google16k_derived.json").read_text())
    objects = truth["frames"][name]
    frame = load_images(
        folder / f"{name}-color.png",
        folder / f"{name}-depth.png",
        folder / f"{name}-label_pred.png",
        np.array(truth["K"]),
        1e-3,
        names={entry["label"]: entry["object"] for entry in objects},
    )
    poses = {entry["label"]: (entry["object"], np.array(entry["T_cam_obj"])) for entry in objects}
    return RealFrame(f"{POSECNN}/{name}", frame, poses)


def _unlabelled(folder: Path) -> RealFrame:
    from scipy.io import loadmat

    from perception.frame_io import load_images

    meta = loadmat(str(folder / "meta.mat"))
    scale = 1 / float(np.squeeze(meta["factor_depth"]))
    frame = load_images(folder / "color.png", folder / "depth.png", None, meta["intrinsic_matrix"], scale)
    return RealFrame(GRASPNET, frame, {})


@dataclass
class Options:
    """Map the published real sensor frames and measure them where the truth is known."""

    data: Path = Path("../shared/data/real_rgbd")
    """Folder of the frames."""
    out: Path = Path("real_out")
    """A result folder for each frame goes here."""
    ycb: Path | None = None
    """Folder of YCB scans; otherwise YCB_DIR and the usual places are tried."""
    preset: str = "tabletop"
    """tabletop or paper."""
    prior: str = "learned"
    """learned or none."""


def main(options: Options) -> None:
    """Map all frames, print and write real.json."""
    from reconstruction import preset, reconstruct, save_reconstruction
    from sim_scenes.objects.ycb import find_ycb
    from tools.options import write_json

    ycb = find_ycb(options.ycb)
    rows: list[dict[str, Any]] = []
    print("frame and object | size [mm] | true size [mm] | IoU | Chamfer [mm] | uncertainty | watertight")
    for real in load_real_frames(options.data):
        result = reconstruct(real.frame, preset(options.preset, prior=options.prior))
        save_reconstruction(result, options.out / real.name.replace("/", "_"), overwrite=True)
        for row in compare(real, result, ycb):
            rows.append(row)
            known = (
                f"{row['true_size_mm']} | {row['iou']} | {row['chamfer_mm']}" if "iou" in row else "- | - | -"
            )
            print(
                f"{row['frame']} {row['name']} | {row['size_mm']} | {known} | {row['mean_uncertainty']} | "
                f"{'yes' if row['watertight'] else 'NO'}"
            )
        for skipped in result.skipped:
            print(f"{real.name} skipped {skipped.name}: {skipped.reason}")
    write_json({"objects": rows}, options.out / "real.json")


if __name__ == "__main__":
    import tyro

    sys.exit(exit_code("real_frames", lambda: main(tyro.cli(Options))))
