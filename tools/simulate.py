"""`contramap scenes` and `contramap fetch ycb`: simulated scenes with truth, and the scans they use."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro


def scenes(
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")],
    *,
    count: int = 10,
    seed: int = 0,
    objects: str = "auto",
    ycb: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    part: str = "all",
    only: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    max_size: float | None = None,
    views: int = 1,
    sensor_noise: bool = False,
    label_noise: bool = False,
    pose_noise: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="M DEG")] = None,
) -> None:
    """Simulate tabletop scenes with known truth, settled by physics.

    Example: contramap scenes scenes100 --count 100 --seed 0 --objects ycb --views 3
    Example: contramap scenes cups --count 20 --objects my_meshes --part held-out --max-size 0.2

    Args:
        out: Folder for scene_0000, scene_0001, ...; finished scenes are kept, so a stopped run goes on.
        count: Scenes.
        seed: Scene i depends on the seed and i alone.
        objects: ycb (real scans), builtin (procedural and shipped shapes), figures (of blocks; they ship with
            pybullet and no training set holds them), or auto: scans where found. Or a folder: all .ply, .obj
            and .glb meshes below it, closed, in metres, standing upright (z up; y up in .glb).
        ycb: Folder of YCB scans; otherwise YCB_DIR, ../shared/data/ycb and the download folder are tried.
        part: Of a folder's objects: all, train or held-out, by name; the prior never learns from held-out.
        only: Of a folder's objects: those named in this text file, one a line.
        max_size: Of a folder's objects: none with a longer side than this [m].
        views: Cameras around each scene; the first is the scene folder itself.
        sensor_noise: Give the depth a real camera's errors.
        label_noise: Erode, dilate and leak the instance masks.
        pose_noise: The stated poses of all views but the first are wrong by up to so many metres and degrees.
    """
    from sim_scenes.dataset import generate
    from sim_scenes.objects.mesh_folder import FolderConfig

    chosen = FolderConfig(part, only, max_size)
    noise = (sensor_noise, label_noise)
    folders = generate(out, count, seed, objects, ycb, views, *noise, folder=chosen, pose_noise=pose_noise)
    print(f"{len(folders)} scenes in {out}")


def fetch_ycb(
    *,
    to: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="ID")] = (),
) -> None:
    """Download YCB scans (google_16k) from the official archives.

    Example: contramap fetch ycb --only 003_cracker_box 006_mustard_bottle

    Args:
        to: Where to unpack; by default the folder that `contramap scenes` looks in.
        only: Object ids; all of them by default.
    """
    from sim_scenes.objects.fetch import fetch_ycb as download

    folder = download(to, only)
    print(f"YCB scans in {folder}")
