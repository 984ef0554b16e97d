"""Labels of one scene in other words: images, stacks, folders of masks, COCO."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from many_words import base
from PIL import Image

from perception import Frame


def without_labels(frame: Frame, folder: Path) -> Path:
    base(frame, folder)
    (folder / "labels.png").unlink()
    return folder


def labels_as(form: str) -> Callable[[Frame, Path], Path]:
    """labels in another form, the names left to names.json."""

    def write(frame: Frame, folder: Path) -> Path:
        assert frame.labels is not None
        without_labels(frame, folder)
        labels = frame.labels
        numbers_of = sorted(set(np.unique(labels).tolist()) - {0})
        masks = np.stack([labels == label for label in numbers_of])
        if form == "int64":
            np.save(folder / "labels.npy", labels.astype(np.int64))
        elif form == "float":
            np.save(folder / "labels.npy", labels.astype(np.float32))
        elif form == "-1":
            np.save(folder / "labels.npy", np.where(labels == 0, -1, labels).astype(np.int32))
        elif form == "255":
            Image.fromarray(np.where(labels == 0, 255, labels).astype(np.uint8)).save(folder / "labels.png")
        elif form == "65535":
            Image.fromarray(np.where(labels == 0, 65535, labels).astype(np.uint16)).save(
                folder / "labels.png"
            )
        elif form == "stack":
            np.save(folder / "masks.npy", masks)
        elif form == "stack last":
            np.save(folder / "masks.npy", np.moveaxis(masks, 0, -1))
        elif form == "torch":
            np.save(folder / "masks.npy", masks[:, None].astype(np.float32))
        elif form == "npz":
            np.savez(folder / "labels.npz", labels=labels)
        elif form == "palette":
            image = Image.fromarray(labels.astype(np.uint8), "P")
            image.putpalette(
                [value for index in range(256) for value in (index * 37 % 256, index * 91 % 256, index)]
            )
            image.save(folder / "labels.png")
        elif form == "grey rgb":
            Image.fromarray(np.repeat(labels[..., None], 3, 2).astype(np.uint8)).save(folder / "labels.png")
        elif form in ("masks", "mask_visib"):
            (folder / form).mkdir()
            for label, mask in zip(numbers_of, masks):
                name = f"{label:06d}.png" if form == "masks" else f"000000_{label - 1:06d}.png"
                Image.fromarray(255 * mask.astype(np.uint8)).save(folder / form / name)
        elif form in ("coco", "coco string", "coco list"):
            entries = [
                {"id": label, "category_id": label, "segmentation": run_lengths(mask, form == "coco string")}
                for label, mask in zip(numbers_of, masks)
            ]
            body: Any = entries if form == "coco list" else {"images": [{"id": 1}], "annotations": entries}
            (folder / "annotations.json").write_text(json.dumps(body))
        else:
            raise ValueError(form)
        return folder

    return write


def run_lengths(mask: np.ndarray, compressed: bool) -> dict[str, Any]:
    """COCO's run lengths of a mask (H, W) bool."""
    column = mask.T.reshape(-1)
    change = np.flatnonzero(np.diff(column)) + 1
    runs = np.diff([0, *change.tolist(), column.size]).tolist()
    if column[0]:
        runs = [0, *runs]
    size = list(mask.shape)
    if not compressed:
        return {"size": size, "counts": runs}
    text = ""
    for index, run in enumerate(runs):
        value = run - (runs[index - 2] if index > 2 else 0)
        more = True
        while more:
            group = value & 0x1F
            value >>= 5
            more = value != (-1 if group & 0x10 else 0)
            text += chr((group | 0x20 if more else group) + 48)
    return {"size": size, "counts": text}
