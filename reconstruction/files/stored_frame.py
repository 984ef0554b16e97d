"""The frame a result was made from, kept in the result folder as a frame folder of its own.

Knows frames and where they lie in a result; knows nothing of meshes or maps. Exports read it: a result alone
is enough to write every format.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from mapping.errors import DataError, FrameError
from perception.frame import Frame
from perception.frame_io import load_frame, save_frame
from perception.observation import Observation
from perception.views.joint import JointObservation

FRAME = "frame"
"""Name of the frame's folder within a result."""
VIEWS = "views"
"""Further views lie in this folder within it, numbered from 1."""
FINEST_SCALE = 1e-4
"""Metres per stored depth unit where the scene is near enough; it adds no error that matters."""
LARGEST_DEPTH = 65535
"""Of a 16-bit image."""


def write_frame(frame: Frame, observation: Observation, result: Path) -> None:
    """Write `result`/frame: depth and colours as they were measured, labels after cleaning. Of several views
    the first, and the others under its views/."""
    farthest = float(np.nanmax(frame.depth))
    scale = max(FINEST_SCALE, farthest / LARGEST_DEPTH)
    if not isinstance(observation, JointObservation):
        save_frame(replace(frame, labels=observation.labels), result / FRAME, scale)
        return
    for number, view in enumerate(observation.views):
        folder = result / FRAME / VIEWS / str(number) if number else result / FRAME
        save_frame(replace(view.frame, labels=view.observation.labels), folder, scale)


def read_views(result: Path, count: int) -> list[Frame]:
    """All `count` views kept in a result folder, the first one first; raises DataError as read_frame does."""
    return [read_frame(result), *(read_frame(result, number) for number in range(1, count))]


def read_frame(result: Path, view: int = 0) -> Frame:
    """The frame kept in a result folder, the first or another view; raises DataError when it is missing or
    damaged."""
    folder = Path(result) / FRAME / (f"{VIEWS}/{view}" if view else "")
    if not folder.is_dir():
        raise DataError(f"{result}: holds no {FRAME}/ (made by an older version); map the frame again")
    try:
        return load_frame(folder)
    except FrameError as error:
        raise DataError(f"the frame kept in {result} is damaged: {error}; map the frame again") from error
