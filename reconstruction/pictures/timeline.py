"""A rerun recording of a map that grows, on the timeline `frame` (and `time`, where stamps are known).

world/table, world/axes         the table frame, static
world/camera                    pose and pinhole of each frame; /rgb its image
world/meshes/<label>_<name>     meshes in the objects' colours, as they become
world/uncertainty/<label>_<name>  the same coloured by p(uncertain)
world/boxes/<label>_<name>      upright boxes with names
progress/all                    mean p(uncertain) of all vertices
progress/<label>_<name>         the same of each object
summary                         text

Knows rerun and reconstructions; knows nothing of where frames come from.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from reconstruction.files.scene_json import object_folder
from reconstruction.pictures.blueprint import growing_blueprint
from reconstruction.pictures.entities import (
    log_table,
    log_text,
    mesh3d,
    pinhole,
    rerun_sdk,
    save_stream,
    view_of,
)
from reconstruction.pictures.guides import log_boxes
from reconstruction.pictures.near_origin import near_origin, shift_of, shifted_pose
from reconstruction.pictures.palette import object_colour, uncertainty_colours
from reconstruction.pictures.summary_text import run_summary

if TYPE_CHECKING:
    from perception.frame import Frame
    from reconstruction.result import Reconstruction

JPEG_QUALITY = 75
ALL = "progress/all"


class Timeline:
    """Collects a recording in memory, frame by frame."""

    def __init__(self) -> None:
        self._stream = rerun_sdk().RecordingStream("contramap")
        self._memory = self._stream.memory_recording()
        self._shown: dict[str, object] = {}

    def add(self, result: Reconstruction, frame: Frame, number: int, stamp: float | None = None) -> None:
        """The map after frame `number` and the frame itself; stamp: when it was taken [s]. Objects whose
        meshes are those of the frame before are not written again."""
        shift = shift_of(result.T_world_table)
        moved, _ = near_origin(result)
        stream = self._stream
        if not self._shown:
            upright = result.observation.support is not None
            log_table(stream, moved.T_world_table, upright)
            stream.send_blueprint(growing_blueprint(*view_of(moved.objects, moved.T_world_table, upright)))
        stream.set_time("frame", sequence=number)
        if stamp is not None:
            stream.set_time("time", timestamp=stamp)
        self._log_camera(frame, shift)
        self._log_objects(result, moved)
        log_text(stream, run_summary(result), static=False)

    def save(self, path: Path) -> None:
        """Write the recording and end it. Raises DataError when writing fails."""
        save_stream(self._stream, self._memory, path)

    def _log_camera(self, frame: Frame, shift: np.ndarray) -> None:
        rr = rerun_sdk()
        camera = frame.camera
        T = shifted_pose(camera.T_world_camera, shift)
        pose = rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])
        self._stream.log("world/camera", pose, pinhole(camera))
        if frame.rgb is not None:
            image = rr.Image(frame.rgb).compress(jpeg_quality=JPEG_QUALITY)
            self._stream.log("world/camera/rgb", image)

    def _log_objects(self, result: Reconstruction, moved: Reconstruction) -> None:
        rr, stream = rerun_sdk(), self._stream
        total = np.concatenate([item.uncertainty for item in result.objects])
        stream.log(ALL, rr.Scalars(float(total.mean())))
        shown: dict[str, object] = {}
        for item, drawn in zip(result.objects, moved.objects):
            key = object_folder(item.label, item.name)
            shown[key] = item.mesh
            stream.log(f"progress/{key}", rr.Scalars(item.mean_uncertainty))
            if self._shown.get(key) is item.mesh:
                continue
            colour = object_colour(item.class_index - 1)
            stream.log(f"world/meshes/{key}", mesh3d(drawn.mesh, colour=colour))
            unsure = mesh3d(drawn.mesh, vertex_colours=uncertainty_colours(item.uncertainty))
            stream.log(f"world/uncertainty/{key}", unsure)
            log_boxes(stream, [drawn], static=False)
        for key in self._shown.keys() - shown.keys():
            for group in ("meshes", "uncertainty", "boxes"):
                stream.log(f"world/{group}/{key}", rr.Clear(recursive=False))
        self._shown = shown
