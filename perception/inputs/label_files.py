"""Labels from files: an image, an array, a folder of masks, COCO's JSON. Knows storage; forms are
label_forms'."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mapping.errors import FrameError
from mapping.guarded_files import names_of_npz, read_npz
from perception.image_io import read_array, read_label_image
from perception.inputs.camera_file import read_content
from perception.inputs.coco import masks_of
from perception.inputs.label_forms import (
    IMAGES,
    MASK_FOLDERS,
    Labels,
    as_labels,
    from_masks,
    number_of_stems,
    on,
)
from perception.inputs.label_slivers import without_slivers

LABEL_FILES = (
    "labels.png", "labels.npy", "labels.npz", "labels.tif", "labels.tiff", "labels.pgm", "labels.bmp",
    "masks.npy",
    "masks.npz", "labels.json", "annotations.json", "masks.json", "instances.json", "coco.json", "labels.jpg",
    "labels.jpeg", "segmap.npy", "seg.png", "segmentation.png", "instances.png",
)  # fmt: skip
"""Files of a frame folder that hold labels, in the order they are looked for."""

NPZ_NAMES = ("labels", "masks", "segmap", "seg", "arr_0")
"""Arrays of an .npz file that can hold labels, in the order they are looked for."""


def find_labels(folder: Path) -> tuple[Path | None, list[str]]:
    """The labels of a frame folder, file or folder of masks, and what else there is in a form for labels."""
    found = [folder / name for name in LABEL_FILES if (folder / name).exists()]
    found += [
        folder / name for name in MASK_FOLDERS if (folder / name).is_dir() and _mask_files(folder / name)
    ]
    return (found[0] if found else None), [path.name for path in found[1:]]


def read_labels(
    path: Path,
    shape: tuple[int, int] | None = None,
    named: tuple[int, ...] = (),
    image_name: str | None = None,
) -> Labels:
    """Labels of a file or folder in any known form.

    shape: (H, W) of the image, for polygons. named: numbers that have names. image_name: the colour file's
    name, for files with many images. Raises FrameError that names the file, the fault and the mend.
    """
    if path.is_dir():
        labels = _from_folder(path)
    elif path.suffix == ".json":
        labels = _from_json(path, shape, image_name)
    elif path.suffix == ".npz":
        labels = as_labels(_only_array(path), str(path), named)
    elif path.suffix == ".npy":
        labels = as_labels(read_array(path), str(path), named)
    else:
        labels = as_labels(read_label_image(path), str(path), named)
    return mended(labels, path.name)


def mended(labels: Labels, name: str) -> Labels:
    """The labels without slivers, and a note where there were some."""
    image, changed, vanished = without_slivers(labels.image)
    if not changed:
        return labels
    lost = (
        f", the numbers {', '.join(map(str, vanished[:8]))}{', ...' if len(vanished) > 8 else ''} among them"
        if vanished
        else ""
    )
    note = (
        f"{name}: {changed} pixels lie in slivers between two labels{lost}: resized by interpolation or "
        f"saved as "
        "JPEG? They went to the nearest label; resize labels with the nearest neighbour and save them as PNG"
    )
    return Labels(image, labels.names, (*labels.notes, note))


def _mask_files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in IMAGES and path.is_file())


def _from_folder(folder: Path) -> Labels:
    files = _mask_files(folder)
    if not files:
        raise FrameError(f"{folder}: holds no mask image (one image a mask, such as 000001.png)")
    numbers, words, note = number_of_stems([path.stem for path in files])
    masks = {}
    for number, path in zip(numbers, files):
        image = read_array(path) if path.suffix == ".npy" else read_label_image(path)
        if image.ndim != 2:
            raise FrameError(f"{path}: a mask must have one channel, got {image.shape}")
        if not (image != 0).any():
            continue  # an object that is hidden in this view
        masks[number] = on(image)
    labels = from_masks(masks, str(folder))
    names = {number: word for number, word in zip(numbers, words) if word is not None and number in masks}
    if len(set(names.values())) == 1 and len(names) > 1:
        names = {}  # a common prefix, not names
    notes = () if note is None else (f"{folder.name}: {note}",)
    return Labels(labels.image, names, notes)


def _from_json(path: Path, shape: tuple[int, int] | None, image_name: str | None) -> Labels:
    content = read_content(path, "it must be COCO's JSON")
    found = masks_of(content, shape or (0, 0), image_name, str(path))
    labels = from_masks({number: mask for number, (mask, _) in found.items()}, str(path))
    return Labels(labels.image, {number: name for number, (_, name) in found.items() if name is not None})


def _only_array(path: Path) -> np.ndarray:
    arrays = read_npz(path, NPZ_NAMES, FrameError)
    key = next((name for name in NPZ_NAMES if name in arrays), None)
    if key is None:
        names = ", ".join(names_of_npz(path, FrameError)) or "nothing"
        raise FrameError(f"{path}: holds {names}; save labels or masks in it")
    return arrays[key]
