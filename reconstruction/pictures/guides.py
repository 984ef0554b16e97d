"""What helps to read a recording: named boxes, axes of the frames, the colour bar, the stages by name.

Knows rerun and results; knows nothing of maps or files.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from reconstruction.files.scene_json import object_folder
from reconstruction.pictures.colour_bar import colour_bar
from reconstruction.pictures.palette import object_colour

if TYPE_CHECKING:
    from reconstruction.files.stored import StoredObject
    from reconstruction.result import ReconstructedObject

AXIS_COLOURS = ((220, 60, 60), (70, 170, 80), (70, 110, 220))
AXIS_LENGTH = 0.1  # [m]
AXIS_RADIUS, BOX_RADIUS = 0.0015, 0.0007  # [m]
BAR_WIDTH = 720  # [px]


def log_boxes(
    stream: Any, objects: Iterable[ReconstructedObject | StoredObject], static: bool = True
) -> None:
    """The upright box of each object, with its name, under world/boxes."""
    import rerun as rr

    for item in objects:
        path = f"world/boxes/{object_folder(item.label, item.name)}"
        T = np.asarray(item.T_world_object, float)
        box = rr.Boxes3D(
            half_sizes=[np.asarray(item.extents, float) / 2],
            labels=[item.name],
            show_labels=True,
            colors=[object_colour(item.class_index - 1)],
            radii=BOX_RADIUS,
            fill_mode=rr.components.FillMode.MajorWireframe,
        )
        stream.log(path, rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]), box, static=static)


def log_axes(stream: Any, path: str, name: str) -> None:
    """Arrows of 10 cm along x, y, z (red, green, blue) of the frame that `path` lies in, with its name."""
    import rerun as rr

    arrows = rr.Arrows3D(
        vectors=AXIS_LENGTH * np.eye(3),
        colors=AXIS_COLOURS,
        radii=AXIS_RADIUS,
        labels=[name],
        show_labels=True,
    )
    stream.log(path, arrows, static=True)


def log_colour_bar(stream: Any) -> None:
    """The colour bar of p(uncertain) as an image."""
    import rerun as rr

    stream.log("legend/uncertainty", rr.Image(np.asarray(colour_bar(BAR_WIDTH, 20))), static=True)


def log_stages(stream: Any, timings_ms: Mapping[str, float]) -> None:
    """One bar a stage, each an entity of its name, so that the view's legend names it."""
    import rerun as rr

    stages = [(stage, value) for stage, value in timings_ms.items() if stage != "total"]
    for place, (stage, value) in enumerate(stages):
        bar = rr.BarChart([value], abscissa=[place], color=object_colour(place))
        stream.log(f"timings/{place + 1}_{stage}", bar, static=True)
