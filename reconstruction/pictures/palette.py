"""The colours of objects, classes and uncertainty, the same in pictures, recordings and mesh files."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import trimesh

EMPTY_COLOUR = (178, 186, 196)
UNCERTAIN_COLOUR = (253, 203, 38)
OTHER_COLOUR = (128, 128, 132)
OBJECT_COLOURS = (
    (66, 133, 214),
    (230, 110, 60),
    (60, 166, 98),
    (214, 76, 108),
    (142, 104, 196),
    (38, 170, 182),
    (196, 148, 40),
    (222, 118, 184),
    (122, 132, 62),
    (150, 98, 72),
)
VIRIDIS_START = 36
"""First entry of the viridis table that is used, of 256."""


def object_colour(index: int) -> tuple[int, int, int]:
    """RGB of the object at position `index`; colours repeat after ten, a little darker each time."""
    base = OBJECT_COLOURS[index % len(OBJECT_COLOURS)]
    shade = 0.78 ** (index // len(OBJECT_COLOURS))
    return (int(base[0] * shade), int(base[1] * shade), int(base[2] * shade))


def uncertainty_colours(uncertainty: np.ndarray) -> np.ndarray:
    """Colours (..., 3) uint8 RGB of p(uncertain) (...,) in [0, 1]: viridis, blue = sure, yellow = guessed.

    The darkest part of viridis is left out: shading would not be seen on it.
    """
    return _viridis()[_entries(uncertainty), :3]


def paint(mesh: trimesh.Trimesh, uncertainty: np.ndarray) -> None:
    """Give a mesh its p(uncertain) (V,) as vertex attribute and colours, so that mesh.export("x.ply") keeps
    both."""
    from trimesh.visual import ColorVisuals

    mesh.visual = ColorVisuals(mesh, vertex_colors=_viridis()[_entries(uncertainty)])
    mesh.vertex_attributes["uncertainty"] = np.asarray(uncertainty, np.float32)


def _entries(uncertainty: np.ndarray) -> np.ndarray:
    """The entries (...,) uint8 of the table for p(uncertain) (...,) in [0, 1]."""
    return np.clip(np.round(np.asarray(uncertainty) * 255), 0, 255).astype(np.uint8)


@lru_cache(maxsize=1)
def _viridis() -> np.ndarray:
    """The table (256, 4) uint8, red, green, blue and opacity: as Trimesh keeps colours."""
    import cv2

    ramp = np.linspace(VIRIDIS_START, 255, 256).round().astype(np.uint8)[None]
    colours = cv2.applyColorMap(ramp, cv2.COLORMAP_VIRIDIS)[0, :, ::-1]
    return np.pad(colours, ((0, 0), (0, 1)), constant_values=255)
