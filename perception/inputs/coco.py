"""Masks in COCO's JSON: run lengths (plain or compressed) and polygons. Knows no files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mapping.errors import FrameError

LARGEST_LABEL = 65535


def masks_of(
    content: Any, shape: tuple[int, int], image_name: str | None, source: str
) -> dict[int, tuple[np.ndarray, str | None]]:
    """Label -> (mask (H, W) bool, category name or None) of one image's annotations.

    content: a COCO data set, or a list of annotations (results of a detector). shape: (H, W) of polygons'
    image. image_name: the colour file's name, which tells one image of many. Raises FrameError.
    """
    annotations, categories = _annotations(content, image_name, source)
    if not annotations:
        raise FrameError(f"{source}: holds no annotation of this image")
    ids = [entry.get("id") for entry in annotations]
    usable = all(type(number) is int and 0 < number <= LARGEST_LABEL for number in ids) and len(
        set(ids)
    ) == len(ids)
    found: dict[int, tuple[np.ndarray, str | None]] = {}
    for order, entry in enumerate(annotations, start=1):
        if not isinstance(entry, Mapping) or "segmentation" not in entry:
            raise FrameError(f"{source}: annotation {order} lacks segmentation (run lengths or polygons)")
        mask = decode(entry["segmentation"], shape, f"{source}: annotation {order}")
        name = entry.get("name") or categories.get(entry.get("category_id"))
        found[int(entry["id"]) if usable else order] = (mask, name if isinstance(name, str) else None)
    return found


def decode(segmentation: Any, shape: tuple[int, int], name: str) -> np.ndarray:
    """Mask (H, W) bool of one segmentation: {"counts", "size"} or polygons [[x, y, ...], ...]."""
    if isinstance(segmentation, Mapping):
        return _from_runs(segmentation, name)
    if isinstance(segmentation, Sequence) and segmentation and not isinstance(segmentation, str):
        return _from_polygons(segmentation, shape, name)
    raise FrameError(f"{name}: segmentation must be run lengths {{counts, size}} or polygons")


def _annotations(content: Any, image_name: str | None, source: str) -> tuple[list[Any], dict[Any, Any]]:
    if isinstance(content, list):
        return content, {}
    if not isinstance(content, Mapping) or not isinstance(content.get("annotations"), list):
        raise FrameError(f"{source}: must be COCO's JSON with a list of annotations")
    categories = {entry.get("id"): entry.get("name") for entry in content.get("categories") or []}
    images = content.get("images") or []
    annotations = content["annotations"]
    if len(images) > 1:
        wanted = [
            entry["id"] for entry in images if str(entry.get("file_name", "")).split("/")[-1] == image_name
        ]
        if len(wanted) != 1:
            raise FrameError(
                f"{source}: holds {len(images)} images and none, or several, is called {image_name}; keep "
                f"the "
                "annotations of this image alone"
            )
        annotations = [entry for entry in annotations if entry.get("image_id") == wanted[0]]
    return annotations, categories


def _from_runs(segmentation: Mapping[str, Any], name: str) -> np.ndarray:
    try:
        height, width = (int(side) for side in segmentation["size"])
        counts = segmentation["counts"]
        runs = _decompress(counts) if isinstance(counts, (str, bytes)) else [int(count) for count in counts]
    except (KeyError, TypeError, ValueError) as error:
        raise FrameError(f"{name}: run lengths need size [H, W] and counts") from error
    if min(runs, default=0) < 0 or sum(runs) != height * width:
        raise FrameError(
            f"{name}: its run lengths cover {sum(runs)} pixels, its size {height}x{width} has "
            f"{height * width}"
        )
    values = np.arange(len(runs)) % 2 == 1  # the first run is background
    return np.repeat(values, runs).reshape(width, height).T.copy()  # COCO counts down the columns


def _decompress(counts: str | bytes) -> list[int]:
    """COCO's string of run lengths: six-bit groups from character 48 on, differences from the third run
    on."""
    text = counts.encode("ascii") if isinstance(counts, str) else counts
    runs: list[int] = []
    position = 0
    while position < len(text):
        value = shift = 0
        more = True
        while more:
            if position >= len(text):
                raise ValueError("cut short")
            group = text[position] - 48
            value |= (group & 0x1F) << (5 * shift)
            more = bool(group & 0x20)
            position += 1
            shift += 1
            if not more and group & 0x10:
                value |= -1 << (5 * shift)
        runs.append(value + runs[-2] if len(runs) > 2 else value)
    return runs


def _from_polygons(polygons: Sequence[Any], shape: tuple[int, int], name: str) -> np.ndarray:
    import cv2

    image = np.zeros(shape, np.uint8)
    try:
        # COCO's coordinates have the first pixel's centre at 0.5.
        rings = [
            np.rint(np.reshape(np.array(ring, float), (-1, 2)) - 0.5).astype(np.int32) for ring in polygons
        ]
    except (TypeError, ValueError) as error:
        raise FrameError(f"{name}: polygons must be lists x0, y0, x1, y1, ...") from error
    for ring in rings:
        cv2.fillPoly(image, [ring], 1)
    return image.astype(bool)
