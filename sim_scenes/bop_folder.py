"""Writes simulated scenes as a data set in BOP's layout: test/, and models/ in millimetres."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from perception import load_frame
from perception.camera import invert_rigid
from perception.frame import Frame
from perception.image_io import write_png
from sim_scenes.objects.object_model import load_model
from sim_scenes.truth import TrueObject, load_truth

DEPTH_SCALE = 0.1
"""Millimetres a unit of depth/: what BOP's depth_scale counts in."""
MILLIMETRES = 1000.0


def write_bop(scenes: Sequence[str | Path], out: str | Path, split: str = "test") -> Path:
    """Write scenes as out/<split>/000001, ..., each view an image, and out/models; gives the split.

    Objects are numbered from 1 in the order they are met; the same name is the same object.
    """
    root = Path(out)
    numbers: dict[str, int] = {}
    for number, folder in enumerate(scenes, start=1):
        truth = load_truth(folder)
        for item in truth.objects:
            if item.name not in numbers:
                numbers[item.name] = len(numbers) + 1
                _write_model(item, root / "models" / f"obj_{numbers[item.name]:06d}.ply")
        place = root / split / f"{number:06d}"
        cameras, poses = {}, {}
        for image, view in enumerate(truth.views):
            frame = load_frame(view)
            cameras[str(image)] = _camera(frame)
            poses[str(image)] = [_pose(item, frame, numbers[item.name]) for item in truth.objects]
            _write_images(frame, [item.label for item in truth.objects], place, f"{image:06d}")
        (place / "scene_camera.json").write_text(json.dumps(cameras, indent=1))
        (place / "scene_gt.json").write_text(json.dumps(poses, indent=1))
    return root / split


def _write_model(item: TrueObject, path: Path) -> None:
    mesh = load_model(item.mesh_path, item.name, item.source, item.scale).mesh.copy()
    mesh.apply_scale(MILLIMETRES)
    path.parent.mkdir(parents=True, exist_ok=True)
    mesh.export(path)


def _camera(frame: Frame) -> dict[str, Any]:
    T = invert_rigid(frame.camera.T_world_camera)
    return {
        "cam_K": frame.camera.K.reshape(-1).tolist(),
        "depth_scale": DEPTH_SCALE,
        "cam_R_w2c": T[:3, :3].reshape(-1).tolist(),
        "cam_t_w2c": (MILLIMETRES * T[:3, 3]).tolist(),
    }


def _pose(item: TrueObject, frame: Frame, number: int) -> dict[str, Any]:
    T = invert_rigid(frame.camera.T_world_camera) @ item.T_world_object
    return {
        "cam_R_m2c": T[:3, :3].reshape(-1).tolist(),
        "cam_t_m2c": (MILLIMETRES * T[:3, 3]).tolist(),
        "obj_id": number,
    }


def _write_images(frame: Frame, labels: Sequence[int], place: Path, stem: str) -> None:
    """rgb/, depth/ and one mask_visib/ image an object, empty where it is hidden."""
    for name in ("rgb", "depth", "mask_visib"):
        (place / name).mkdir(parents=True, exist_ok=True)
    if frame.rgb is not None:
        write_png(place / "rgb" / f"{stem}.png", frame.rgb)
    units = np.rint(np.nan_to_num(frame.depth) * MILLIMETRES / DEPTH_SCALE)
    write_png(place / "depth" / f"{stem}.png", np.where(units <= 65535, units, 0).astype(np.uint16))
    for index, label in enumerate(labels):
        mask = np.zeros(frame.depth.shape, bool) if frame.labels is None else frame.labels == label
        write_png(place / "mask_visib" / f"{stem}_{index:06d}.png", 255 * mask.astype(np.uint8))
