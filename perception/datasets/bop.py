"""BOP's layout: rgb/, depth/, mask_visib/, scene_camera.json, scene_gt.json, models in millimetres.

One image becomes a frame, whose world is the data set's if it has one, else the camera. Object k of
scene_gt.json has label k + 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mapping.errors import DataError, FrameError
from mapping.guarded_files import read_json
from perception.frame import Frame
from perception.image_io import read_label_image
from perception.inputs.assemble import Parts, assemble
from perception.inputs.camera_file import find_file, read_camera
from perception.inputs.depth_files import read_depth
from perception.inputs.label_forms import Labels, from_masks, on
from perception.inputs.pose import compose

MILLIMETRE = 1e-3
IMAGES = (".png", ".jpg", ".tif", ".tiff")


@dataclass(frozen=True)
class BopObject:
    """One object of an image. T_camera_object: (4, 4) [m], model: its mesh file in millimetres or None."""

    label: int
    object_id: int
    T_camera_object: np.ndarray
    model: Path | None

    @property
    def name(self) -> str:
        """BOP's own name of the object."""
        return f"obj_{self.object_id:06d}"


def load_bop(folder: str | Path, scene: int, image: int, *, trust: Sequence[str] = ()) -> Frame:
    """One image of a split folder (such as ycbv/test) as a frame, labels from mask_visib/.

    Raises FrameError that names the file at fault; without masks the depth is segmented, and that is said.
    """
    place = scene_folder(Path(folder), scene)
    stem = f"{image:06d}"
    camera_path = place / "scene_camera.json"
    camera = read_camera(camera_path, str(image))
    depth = find_file(place / "depth", (stem,), IMAGES)
    if depth is None:
        raise FrameError(f"{place / 'depth'}: holds no image {stem}; the scene has {_some(place / 'depth')}")
    labels = _masks(place, stem)
    objects = bop_objects(folder, scene, image) if (place / "scene_gt.json").exists() else []
    notes = () if labels is not None else (f"{place}: holds no masks of image {stem} (mask_visib/)",)
    return assemble(
        Parts(
            depth=read_depth(depth),
            camera=replace(camera, trust=(*camera.trust, *trust)),
            camera_name=str(camera_path),
            source=f"{place} image {image}",
            rgb=find_file(place / "rgb", (stem,), IMAGES) or find_file(place / "gray", (stem,), IMAGES),
            labels=labels,
            names={item.label: item.name for item in objects} if labels is not None else {},
            scale_name=str(camera_path),
            notes=notes,
        )
    )


def bop_objects(folder: str | Path, scene: int, image: int) -> list[BopObject]:
    """The objects of an image with their true poses, in the order of scene_gt.json. Raises DataError."""
    place = scene_folder(Path(folder), scene)
    path = place / "scene_gt.json"
    entries = _read(path).get(str(image))
    if entries is None:
        raise DataError(f"{path}: holds no image {image}")
    models = _models(Path(folder))
    found = []
    for index, entry in enumerate(entries):
        try:
            R = np.reshape(np.array(entry["cam_R_m2c"], float), (3, 3))
            t = MILLIMETRE * np.reshape(np.array(entry["cam_t_m2c"], float), 3)
            number = int(entry["obj_id"])
        except (KeyError, TypeError, ValueError) as error:
            raise DataError(
                f"{path}: image {image}, object {index}: needs cam_R_m2c, cam_t_m2c and obj_id"
            ) from error
        mesh = None if models is None else models / f"obj_{number:06d}.ply"
        found.append(BopObject(index + 1, number, compose(R, t), mesh if mesh and mesh.is_file() else None))
    return found


def bop_images(folder: str | Path) -> list[tuple[int, int]]:
    """(scene, image) of every image of a split folder that has truth, in order. Raises DataError."""
    root = Path(folder)
    scenes = sorted(path.parent for path in root.glob("[0-9]*/scene_gt.json"))
    scenes = scenes or sorted(path.parent for path in root.glob("*/[0-9]*/scene_gt.json"))
    if not scenes:
        raise DataError(f"{root}: no scene of BOP's layout (folders 000001/ with scene_gt.json) in it")
    return [
        (int(place.name), int(image))
        for place in scenes
        for image in sorted(_read(place / "scene_gt.json"), key=int)
    ]


def scene_folder(folder: Path, scene: int) -> Path:
    """The folder of a scene; FrameError names those that are there."""
    place = folder / f"{scene:06d}"
    if not place.is_dir():
        below = sorted(folder.glob(f"*/{scene:06d}"))
        if len(below) == 1:  # the data set's root was given, and one split has the scene
            return below[0]
        raise FrameError(f"{folder}: holds no scene {scene:06d}; it has {_some(folder)}")
    return place


def _masks(place: Path, stem: str) -> Labels | None:
    """Labels from one file a mask, 000003_000000.png; what is visible goes before what is whole."""
    for name in ("mask_visib", "mask"):
        files = sorted((place / name).glob(f"{stem}_*.png"))
        if files:
            masks = {int(path.stem.split("_")[1]) + 1: on(read_label_image(path)) for path in files}
            return from_masks({label: mask for label, mask in masks.items() if mask.any()}, str(place / name))
    return None


def _models(folder: Path) -> Path | None:
    """The folder of models beside or in the split folder; the evaluation's own go first."""
    names = ("models_eval", "models")
    found = [root / name for root in (folder, folder.parent) for name in names if (root / name).is_dir()]
    return found[0] if found else None


def _read(path: Path) -> dict[str, Any]:
    content = read_json(path, "it is part of BOP's layout", DataError)
    if not isinstance(content, dict):
        raise DataError(f"{path}: must hold a JSON object of images")
    return content


def _some(folder: Path) -> str:
    names = sorted(path.stem for path in folder.iterdir()) if folder.is_dir() else []
    return ", ".join(names[:5]) + (f", ... ({len(names)})" if len(names) > 5 else "") if names else "nothing"
