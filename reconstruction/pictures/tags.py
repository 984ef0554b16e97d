"""Names in a picture: each near its object, none on another name, and off what is small.

Knows masks and rectangles in pixels; knows nothing of reconstructions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import ImageDraw

from reconstruction.pictures.colour_bar import font

TEXT, HEIGHT, MARGIN = 13, 19, 2  # [px]
STEP = 4
"""Places are tried this far apart [px]."""
COVERED = 300.0
"""Covering an object wholly is as bad as standing this far from one's own [px]."""
NOT_ABOVE = 8.0
"""A name above its object is preferred to one beside or below that is nearer by less than this [px]."""
LEADER = 10.0
"""A name farther from its object than this [px] is joined to it by a line."""


@dataclass(frozen=True)
class Tag:
    """A name, its colour, and where its object is seen: mask (H, W) bool, in the picture."""

    text: str
    colour: tuple[int, int, int]
    mask: np.ndarray


def draw_tags(draw: ImageDraw.ImageDraw, tags: Sequence[Tag]) -> None:
    """Write names near their objects; a name that has to stand apart gets a line to its object."""
    tags = [tag for tag in tags if tag.mask.any()]
    places = place([tag.mask for tag in tags], [draw.textlength(tag.text, font(TEXT)) + 10 for tag in tags])
    for tag, (left, top, right, bottom) in zip(tags, places):
        x0, y0, x1, y1 = _bounds(tag.mask)
        if max(x0 - right, left - x1, y0 - bottom, top - y1) > LEADER:
            middle = ((left + right) / 2, (top + bottom) / 2)
            rows, columns = np.nonzero(tag.mask)
            nearest = np.argmin((columns - middle[0]) ** 2 + (rows - middle[1]) ** 2)
            line = (*middle, columns[nearest], rows[nearest])
            draw.line(line, (255, 255, 255), 4)
            draw.line(line, tag.colour, 2)
    for tag, (left, top, right, bottom) in zip(tags, places):
        draw.rounded_rectangle((left, top, right, bottom), 5, tag.colour)
        middle = ((left + right) / 2, (top + bottom) / 2)
        draw.text(middle, tag.text, (255, 255, 255), font(TEXT), anchor="mm")


def place(masks: Sequence[np.ndarray], widths: Sequence[float]) -> list[tuple[float, float, float, float]]:
    """Left, top, right, bottom [px] of a name of each width beside its object's mask (H, W)."""
    if not masks:
        return []
    height, width = masks[0].shape
    weight = sum(mask / mask.sum() for mask in masks)
    covered = np.zeros((height + 1, width + 1))
    covered[1:, 1:] = np.cumsum(np.cumsum(weight, axis=0), axis=1)
    places: dict[int, tuple[float, float, float, float]] = {}
    for index in np.argsort([mask.sum() for mask in masks], kind="stable"):
        wide = min(int(np.ceil(widths[index])), width - 2 * MARGIN)
        left = np.arange(MARGIN, width - wide - MARGIN + 1, STEP)[None, :]
        top = np.arange(MARGIN, height - HEIGHT - MARGIN + 1, STEP)[:, None]
        right, bottom = left + wide, top + HEIGHT
        x0, y0, x1, y1 = _bounds(masks[index])
        aside = np.maximum(np.maximum(x0 - right, left - x1), 0)
        apart = np.maximum(np.maximum(y0 - bottom, top - y1), 0)
        cost = np.hypot(aside, apart) + NOT_ABOVE * (bottom > y0) + 0.05 * np.abs(left + right - x0 - x1)
        cost = cost + COVERED * (
            covered[bottom, right] - covered[top, right] - covered[bottom, left] + covered[top, left]
        )
        for a, b, c, d in places.values():
            cost = cost + 1e4 * ((left < c) & (a < right) & (top < d) & (b < bottom))
        row, column = np.unravel_index(np.argmin(cost), cost.shape)
        places[int(index)] = (
            float(left[0, column]),
            float(top[row, 0]),
            float(right[0, column]),
            float(bottom[row, 0]),
        )
    return [places[index] for index in range(len(masks))]


def _bounds(mask: np.ndarray) -> tuple[int, int, int, int]:
    """Left, top, right, bottom [px] of a mask."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return int(columns[0]), int(rows[0]), int(columns[-1]), int(rows[-1])
