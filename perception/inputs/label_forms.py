"""Instance labels in the forms people have them, as one image of numbers. Knows pixels, not depth.

Numbers are kept where the form has numbers (label images, file names, annotation ids), so that names
given for numbers stay right; otherwise they are given in order, from 1.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from mapping.errors import FrameError

TOPS = (255, 65535)
"""Numbers that people use for "no object" or "ignore"."""
BACKGROUND_SHARE = 0.4
"""Where a top number or -1 has this share of the image, it is the background, and 0 can be an object."""
MASK_FOLDERS = ("mask_visib", "masks", "mask")
"""Folders with one image a mask, in the order they are looked for: what is visible goes before what is
whole."""
IMAGES = (".png", ".bmp", ".tif", ".tiff", ".pgm", ".jpg", ".jpeg", ".npy")
ROW_GAP = 1.5
"""A top number this many times farther off than the others lie from each other is none of them."""
HALF = 0.5
"""Scores above this are the mask."""


@dataclass(frozen=True)
class Labels:
    """image: (H, W) uint16, 0 = background. names: label -> name, where the form has names. notes: one line
    each."""

    image: np.ndarray
    names: dict[int, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def as_labels(array: np.ndarray, source: str, named: Sequence[int] = ()) -> Labels:
    """Labels from an array: (H, W) whole numbers or bool, or a stack (N, H, W) of masks.

    Floats are taken where all are whole. -1, 255 and 65535 beside other numbers are no object, unless
    `named` holds them. Raises FrameError.
    """
    array = np.asarray(array)
    if array.ndim == 4 and 1 in (array.shape[1], array.shape[-1]):
        array = array[:, 0] if array.shape[1] == 1 else array[..., 0]
    if array.ndim == 3 and array.shape[0] == 1:
        array = array[0]
    if array.ndim == 3 and array.shape[-1] == 1:
        array = array[..., 0]
    if array.ndim == 3:
        return from_stack(array, source)
    if array.ndim != 2:
        raise FrameError(
            f"{source}: labels must be (H, W) whole numbers or (N, H, W) masks, got {array.shape}"
        )
    if array.dtype == bool:
        return Labels(array.astype(np.uint16))
    return _numbers(_whole(array, source), source, named)


def from_stack(masks: np.ndarray, source: str) -> Labels:
    """Labels 1..N from masks (N, H, W), or (H, W, N): bool, 0 and another number, or scores in 0..1."""
    if not (masks.dtype == bool or np.issubdtype(masks.dtype, np.number)):
        raise FrameError(f"{source}: masks must be bool or numbers, got {masks.dtype}")
    if masks.shape[-1] < min(masks.shape[:2]):
        masks = np.moveaxis(masks, -1, 0)
    if len(masks) > min(masks.shape[1:]):
        raise FrameError(f"{source}: masks must be (N, H, W), got {masks.shape}")
    if masks.dtype != bool:
        for index, mask in enumerate(masks):
            if np.issubdtype(masks.dtype, np.integer) and len(np.unique(mask)) > 2:
                raise FrameError(
                    f"{source}: mask {index} of the stack {masks.shape} holds more than two numbers; give "
                    f"one mask a "
                    "layer, or one (H, W) image of labels (a coloured picture of labels cannot be used)"
                )
    return from_masks({index + 1: on(mask) for index, mask in enumerate(masks)}, source)


def from_masks(masks: Mapping[int, np.ndarray], source: str) -> Labels:
    """One label image from masks (H, W) bool by label; where they overlap the smaller one lies on top."""
    if not masks:
        raise FrameError(f"{source}: no mask in it")
    shapes = {mask.shape for mask in masks.values()}
    if len(shapes) > 1:
        raise FrameError(f"{source}: masks have several sizes ({', '.join(map(str, sorted(shapes)))})")
    image = np.zeros(shapes.pop(), np.uint16)
    for label in sorted(masks, key=lambda number: -int(masks[number].sum())):
        if not 0 < label < 65536:
            raise FrameError(f"{source}: labels must lie in 1..65535, got {label}")
        image[masks[label]] = label
    return Labels(image)


def on(mask: np.ndarray) -> np.ndarray:
    """Where a mask (H, W) is set: bool, scores above one half, or values nearer to its largest than to 0."""
    if mask.dtype == bool:
        return mask
    if np.issubdtype(mask.dtype, np.floating):
        return np.asarray(mask > HALF * max(1.0, float(np.nanmax(mask, initial=0.0))))
    return np.asarray(mask > HALF * float(mask.max(initial=0)))


def number_of_stems(stems: Sequence[str]) -> tuple[list[int], list[str | None], str | None]:
    """Label of each mask file, the name its stem gives it or None, and a note or None.

    The last number of the stems, if they differ; from 1 on, because 0 is the background.
    """
    found = [re.findall(r"\d+", stem) for stem in stems]
    plain = [re.fullmatch(r"[\d_\-. ]+", stem) is not None for stem in stems]
    for position in (-1, 0):
        numbers = [int(parts[position]) if parts else -1 for parts in found]
        if min(numbers, default=-1) >= 0 and len(set(numbers)) == len(numbers) and max(numbers) < 65535:
            shift = min(numbers) == 0
            names = [None if bare else _word(stem) for stem, bare in zip(stems, plain)]
            note = (
                "mask files are counted from 0; their labels are one more, 0 is the background"
                if shift
                else None
            )
            return [number + shift for number in numbers], names, note
    return list(range(1, len(stems) + 1)), list(stems), None


def _word(stem: str) -> str | None:
    """What is left of a file's stem without its numbers and the word mask."""
    word = re.sub(
        r"(?i)mask|segm?(entation)?|label|instance|object|obj", "", re.sub(r"[\d]+", "", stem)
    ).strip("_-. ")
    return word or None


def _whole(array: np.ndarray, source: str) -> np.ndarray:
    if np.issubdtype(array.dtype, np.integer):
        return array.astype(np.int64)
    if np.issubdtype(array.dtype, np.floating):
        filled = np.where(np.isnan(array), 0, array)
        if np.isfinite(filled).all() and (filled == np.rint(filled)).all():
            return filled.astype(np.int64)
        raise FrameError(
            f"{source}: labels must be whole numbers (integers), got {array.dtype} with fractions; resize "
            f"labels with "
            "the nearest neighbour, not by interpolation"
        )
    raise FrameError(f"{source}: labels must be whole numbers (integers), got {array.dtype}")


def _numbers(image: np.ndarray, source: str, named: Sequence[int]) -> Labels:
    """Label image (H, W) int64 with what is no object set to 0."""
    notes: list[str] = []
    names: dict[int, str] = {}
    if image.size and image.min() < -1:
        raise FrameError(f"{source}: labels must lie in 0..65535, got {image.min()}..{image.max()}")
    values, counts = np.unique(image, return_counts=True)
    others = [int(value) for value in values if value > 0 and value not in TOPS]
    empties = [
        int(v) for v in values if v == -1 or (v in TOPS and others and v not in named and _apart(v, others))
    ]
    empty = np.isin(image, empties)
    share = float(empty.mean()) if empty.size else 0.0
    zero_is_object = (
        share > BACKGROUND_SHARE and 0 in values and int(counts[values == 0][0]) < 0.25 * image.size
    )
    if empties:
        word = "the background" if share > BACKGROUND_SHARE else '"ignore"'
        notes.append(
            f"{source}: {', '.join(map(str, empties))} ({int(empty.sum())} pixels) is taken as {word}, no "
            f"object; "
            "name it in names.json if it is one"
        )
    if zero_is_object:
        new = max([*others, 0]) + 1
        image = np.where(image == 0, new, image)
        notes.append(
            f"{source}: 0 is an object here, because {empties[0]} is the background; it is label {new} now"
        )
    image = np.where(empty, 0, image)
    if image.size and image.max() > 65535:
        raise FrameError(f"{source}: labels must lie in 0..65535, got {image.min()}..{image.max()}")
    return Labels(image.astype(np.uint16), names, tuple(notes))


def _apart(top: int, others: Sequence[int]) -> bool:
    """Whether a top number stands out of the row of the other labels (85, 170, 255 is one row)."""
    row = np.sort(np.array([0, *(other for other in others if other < top)]))
    return bool(top - row[-1] > ROW_GAP * max(1, int(np.diff(row).max(initial=1))))
