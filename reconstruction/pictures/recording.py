"""One rerun recording per run, written to a file or shown live.

world                           annotation context: 0 background and empty, each label, uncertain
world/camera                    pose and pinhole; /rgb /depth /labels are its images
world/cloud/objects             the cleaned points of the objects, coloured
world/cloud/background          all other measured points
world/table                     the table frame; the map's own frame
world/table/hinges              hinge points
world/table/samples/<class>     training samples: empty, <label>_<name>, uncertain
world/meshes/<label>_<name>     result meshes in the objects' colours
world/uncertainty/<label>_<name>  the same coloured by p(uncertain)
world/boxes/<label>_<name>      each object's upright box with its name
world/axes                      the world frame, 10 cm; world/table/axes is the table frame
world/truth/<label>             true meshes, where known
world/slice                     p(uncertain) on a horizontal cut
fit/loss                        one value a step, on the timeline `step`
timings/<n>_<stage>             milliseconds of each stage
legend/uncertainty              the colour bar of p(uncertain)
summary                         text
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh

from mapping.errors import ConfigError
from mapping.folders import check_writable
from perception.camera import transform
from reconstruction.files.scene_json import object_folder
from reconstruction.pictures.blueprint import mesh_blueprint, run_blueprint
from reconstruction.pictures.entities import (
    log_table,
    log_text,
    mesh3d,
    pinhole,
    rerun_sdk,
    save_stream,
    view_of,
)
from reconstruction.pictures.guides import log_boxes, log_stages
from reconstruction.pictures.near_origin import near_origin, shift_of, shifted_mesh, shifted_pose
from reconstruction.pictures.palette import (
    EMPTY_COLOUR,
    OTHER_COLOUR,
    UNCERTAIN_COLOUR,
    object_colour,
    uncertainty_colours,
)
from reconstruction.pictures.slices import slice_uncertainty
from reconstruction.pictures.summary_text import run_summary, stored_summary

if TYPE_CHECKING:
    from reconstruction.files.stored import StoredObject, StoredResult
    from reconstruction.result import ReconstructedObject, Reconstruction


Truth = Mapping[int, trimesh.Trimesh]
TRUTH_COLOUR = (90, 200, 120, 110)
HINGE_COLOUR = (226, 230, 236)
SEGMENTATION_OPACITY = 0.45
MAGIC = b"RR"
"""How recordings of all versions of rerun begin: RRF2, RRIO."""
POINT_RADIUS, SAMPLE_RADIUS, HINGE_RADIUS = 0.0008, 0.0018, 0.0012  # [m]


def record(reconstruction: Reconstruction, path: Path, truth: Truth | None = None) -> None:
    """Write the recording of a run; truth: label -> true mesh in the world frame [m].

    Raises ConfigError when rerun is not installed, DataError when the file cannot be written.
    """
    reconstruction, truth = near_origin(reconstruction, truth)
    stream = rerun_sdk().RecordingStream("contramap")
    memory = stream.memory_recording()
    stream.send_blueprint(_blueprint(reconstruction))
    _log_run(stream, reconstruction, truth)
    save_stream(stream, memory, path)


def check_recording(path: Path) -> None:
    """Raise ConfigError when a file is there that is no recording, and so is not replaced; call it before
    long work."""
    path = Path(path)
    if path.is_dir():
        raise ConfigError(f"{path} is a folder; the recording needs a file name, such as {path / 'run.rrd'}")
    if path.is_file() and path.stat().st_size and not path.read_bytes()[:4].startswith(MAGIC):
        raise ConfigError(
            f"{path} is there and is no rerun recording, so it is not replaced; name another file"
        )
    check_writable(path.absolute().parent)


def show(reconstruction: Reconstruction, truth: Truth | None = None) -> None:
    """Open the rerun viewer and send the run to it; needs a display."""
    reconstruction, truth = near_origin(reconstruction, truth)
    stream = rerun_sdk().RecordingStream("contramap")
    stream.spawn(default_blueprint=_blueprint(reconstruction))
    _log_run(stream, reconstruction, truth)
    stream.flush()


def record_stored(result: StoredResult, path: Path) -> None:
    """Write a recording of a result folder's meshes, for results whose run was not recorded."""
    stream = rerun_sdk().RecordingStream("contramap")
    memory = stream.memory_recording()
    T_world_table = np.array(result.scene.get("T_world_table") or np.eye(4), float).reshape(4, 4)
    shift = shift_of(T_world_table)
    T_world_table = shifted_pose(T_world_table, shift)
    upright = result.scene.get("support_plane") is not None
    log_table(stream, T_world_table, upright)
    objects = [
        replace(
            item,
            mesh=shifted_mesh(item.mesh, shift),
            T_world_object=shifted_pose(item.T_world_object, shift),
        )
        for item in result.objects
    ]
    for item in objects:
        _log_mesh(stream, item, object_colour(item.class_index - 1))
    log_boxes(stream, objects)
    stream.send_blueprint(mesh_blueprint(*view_of(objects, T_world_table, upright)))
    timings = {str(stage): float(value) for stage, value in result.scene.get("timings_ms", {}).items()}
    log_stages(stream, timings)
    log_text(stream, stored_summary(result.objects, timings))
    save_stream(stream, memory, path)


def _log_run(stream: Any, reconstruction: Reconstruction, truth: Truth | None) -> None:
    has_plane = reconstruction.observation.support is not None
    log_table(stream, reconstruction.T_world_table, upright=has_plane)
    uncertain, other = _log_classes(stream, reconstruction)
    _log_camera(stream, reconstruction)
    _log_map(stream, reconstruction, uncertain, other)
    for item in reconstruction.objects:
        _log_mesh(stream, item, object_colour(item.class_index - 1))
    log_boxes(stream, reconstruction.objects)
    if reconstruction.other is not None:
        stream.log("world/meshes/other", mesh3d(reconstruction.other.mesh, colour=OTHER_COLOUR), static=True)
    for label, mesh in (truth or {}).items():
        stream.log(f"world/truth/{label}", mesh3d(mesh, colour=TRUTH_COLOUR), static=True)
    if reconstruction.objects:
        _log_slice(stream, reconstruction)
    log_text(stream, run_summary(reconstruction))


def _log_classes(stream: Any, reconstruction: Reconstruction) -> tuple[int, int]:
    """Log the annotation context: instance labels keep their numbers. Returns those of the uncertain class
    and of obstacles without a label."""
    objects = reconstruction.observation.objects
    taken = {item.label for item in objects}
    uncertain, other = [number for number in range(65535, 0, -1) if number not in taken][:2]
    # Clear, so that the background of the label image shows the photo; empty samples carry their own colour.
    classes = [(0, "empty", (*EMPTY_COLOUR, 0)), (uncertain, "uncertain", (*UNCERTAIN_COLOUR, 255))]
    classes.append((other, "other", (*OTHER_COLOUR, 255)))
    classes += [(item.label, item.name, (*object_colour(i), 255)) for i, item in enumerate(objects)]
    stream.log("world", rerun_sdk().AnnotationContext(classes), static=True)
    return uncertain, other


def _log_camera(stream: Any, reconstruction: Reconstruction) -> None:
    rr = rerun_sdk()
    frame, observation = reconstruction.frame, reconstruction.observation.first
    camera = frame.camera
    T = camera.T_world_camera
    stream.log(
        "world/camera", rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]), pinhole(camera), static=True
    )
    if frame.rgb is not None:
        stream.log("world/camera/rgb", rr.Image(frame.rgb), static=True)
    near, far = np.nanpercentile(frame.depth, [1, 99])  # a few stray pixels must not stretch the colours
    depth = rr.DepthImage(
        np.nan_to_num(frame.depth),
        meter=1.0,
        depth_range=[near, max(far, near + 1e-3)],
        colormap=rr.components.Colormap.Viridis,
    )
    stream.log("world/camera/depth", depth, static=True)
    segmentation = rr.SegmentationImage(observation.labels, opacity=SEGMENTATION_OPACITY)
    stream.log("world/camera/labels", segmentation, static=True)
    points = transform(T, camera.back_project(observation.depth))
    measured, labelled = np.isfinite(observation.depth), observation.labels > 0
    for name, part in (("objects", measured & labelled), ("background", measured & ~labelled)):
        colours = frame.rgb[part] if frame.rgb is not None else EMPTY_COLOUR
        cloud = rr.Points3D(points[part], colors=colours, radii=POINT_RADIUS)
        stream.log(f"world/cloud/{name}", cloud, static=True)


def _log_map(stream: Any, reconstruction: Reconstruction, uncertain: int, other: int) -> None:
    """Hinge points, training samples by class, and how the fit went."""
    rr = rerun_sdk()
    model = reconstruction.map
    hinges = rr.Points3D(model.hinges, colors=HINGE_COLOUR, radii=HINGE_RADIUS)
    stream.log("world/table/hinges", hinges, static=True)
    seen = reconstruction.observation.objects
    classes = reconstruction.sample_classes
    classes = classes.argmax(axis=1) if classes.ndim == 2 else classes
    others = model.class_count - 2 - len(seen)
    names = ["empty", *(object_folder(item.label, item.name) for item in seen), *["other"] * others]
    names.append("uncertain")
    numbers = [0, *(item.label for item in seen), *[other] * others, uncertain]
    for index, (name, number) in enumerate(zip(names, numbers, strict=True)):
        points = reconstruction.samples[classes == index]
        colours = EMPTY_COLOUR if index == 0 else None
        samples = rr.Points3D(points, class_ids=number, colors=colours, radii=SAMPLE_RADIUS)
        stream.log(f"world/table/samples/{name}", samples, static=True)
    losses = model.report.losses
    stream.log("fit/loss", rr.SeriesLines(colors=object_colour(0), names="loss", widths=2), static=True)
    if losses:
        steps = rr.TimeColumn("step", sequence=range(len(losses)))
        stream.send_columns("fit/loss", indexes=[steps], columns=rr.Scalars.columns(scalars=losses))
    log_stages(stream, reconstruction.timings_ms)


def _log_mesh(stream: Any, item: ReconstructedObject | StoredObject, colour: tuple[int, ...]) -> None:
    key = object_folder(item.label, item.name)
    stream.log(f"world/meshes/{key}", mesh3d(item.mesh, colour=colour), static=True)
    unsure = mesh3d(item.mesh, vertex_colours=uncertainty_colours(item.uncertainty))
    stream.log(f"world/uncertainty/{key}", unsure, static=True)


def _log_slice(stream: Any, reconstruction: Reconstruction) -> None:
    """The slice as a picture on a flat square; the texture's first row is its far edge."""
    section = slice_uncertainty(reconstruction)
    square = rerun_sdk().Mesh3D(
        vertex_positions=section.corners,
        triangle_indices=[[0, 1, 2], [0, 2, 3]],
        vertex_texcoords=[[0, 0], [1, 0], [1, 1], [0, 1]],
        albedo_texture=uncertainty_colours(section.values),
    )
    stream.log("world/slice", square, static=True)


def _blueprint(reconstruction: Reconstruction) -> Any:
    upright = reconstruction.observation.support is not None
    return run_blueprint(*view_of(reconstruction.objects, reconstruction.T_world_table, upright))
