"""The colour bar of p(uncertain), for pictures and recordings, and the font of both.

Knows colours and text; knows nothing of scenes.
"""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from reconstruction.pictures.palette import uncertainty_colours

TEXT_COLOUR = (40, 44, 52)
PAPER = (255, 255, 255)
RAMP = 14
"""Height of the ramp [px]; its numbers take as much again below it."""
TICKS = {0.0: ("0  seen", "lm"), 0.5: ("p(uncertain)", "mm"), 1.0: ("guessed  1", "rm")}
"""Text and anchor at each value."""


def colour_bar(width: int, text: int = 13) -> Image.Image:
    """The ramp, `width` px wide, over its words in letters of `text` px."""
    picture = Image.new("RGB", (width, RAMP + 2 * text), PAPER)
    ramp = uncertainty_colours(np.tile(np.linspace(0, 1, width), (RAMP, 1)))
    picture.paste(Image.fromarray(ramp), (0, 0))
    draw = ImageDraw.Draw(picture)
    for value, (words, anchor) in TICKS.items():
        draw.text((value * width, RAMP + text), words, TEXT_COLOUR, font(text), anchor=anchor)
    return picture


def font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Pillow's own scalable font: the same picture on every machine."""
    return ImageFont.load_default(size)
