"""A data set in BOP's layout as scene folders for the evaluation: frames, and the true poses of models."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from mapping.errors import DataError, FrameError
from mapping.files import write_atomically
from perception import load_frame, observe, save_frame
from perception.datasets.bop import BopObject, bop_images, bop_objects, load_bop
from perception.frame import Frame
from sim_scenes.objects.object_model import load_model
from sim_scenes.truth import TRUTH_FILE

DEPTH_SCALE = 1e-4
"""Metres a unit of the scene folders' depth."""
MODEL_SCALE = 1e-3
"""BOP's models are in millimetres."""


def scenes_of_bop(folder: Path, out: Path, limit: int | None = None) -> Path:
    """Write a scene folder below `out` for each image of a split folder; those that are there are kept.

    Images without masks or without a support are passed over and named. Raises DataError when none is left.
    """
    images = bop_images(folder)[:limit]
    written = 0
    for scene, image in tqdm(images, desc="BOP images", unit="image"):
        place = out / f"{scene:06d}_{image:06d}"
        if not (place / TRUTH_FILE).is_file():
            try:
                frame = load_bop(folder, scene, image)
                _write(frame, bop_objects(folder, scene, image), place)
            except FrameError as error:
                tqdm.write(f"passed over: {error}")
                continue
        written += 1
    if not written:
        raise DataError(
            f"{folder}: no image can be evaluated: it needs mask_visib/, scene_gt.json and models/"
        )
    return out


def _write(frame: Frame, objects: list[BopObject], place: Path) -> None:
    if frame.labels is None:
        raise FrameError(f"{frame.source}: without masks there is nothing to compare")
    save_frame(frame, place, DEPTH_SCALE)
    support = observe(load_frame(place)).support
    if support is None:
        raise FrameError(f"{frame.source}: no support plane is seen")
    T = frame.camera.T_world_camera
    normal = T[:3, :3] @ support.normal
    plane = [*normal.tolist(), float(support.offset - normal @ T[:3, 3])]
    truth: dict[str, Any] = {
        "seed": 0,
        "support_plane": plane,
        "views": ["."],
        "objects": [_entry(item, T) for item in objects if item.model is not None],
    }
    if not truth["objects"]:
        raise FrameError(
            f"{frame.source}: none of its objects has a model (models/obj_000001.ply) beside the split"
        )
    write_atomically(place / TRUTH_FILE, (json.dumps(truth, indent=1) + "\n").encode())


def _entry(item: BopObject, T_world_camera: np.ndarray) -> dict[str, Any]:
    assert item.model is not None
    model = load_model(item.model, item.name, "bop", MODEL_SCALE)
    return {
        "label": item.label,
        "name": item.name,
        "source": "bop",
        "mesh": str(item.model.resolve()),
        "scale": MODEL_SCALE,
        "T_world_object": (T_world_camera @ item.T_camera_object).tolist(),
        "watertight": model.watertight,
    }
