"""The result folder: what `contramap map` leaves on disk, written as a whole or not at all.

scene.json                        frame, unit, objects, what was skipped, timings, configuration, versions
objects/<label>_<name>/mesh.ply   [m, world frame], p(uncertain) at each vertex, and its colours
objects/<label>_<name>/mesh.obj   the same surface for planners
objects/other/mesh.ply, mesh.obj  obstacles near objects that were measured but carry no label, if any
map.npz                           the fitted map (mapping.load_map)
field.npz                         occupancy and p(uncertain) on each object's lattice
frame/                            the frame: depth and colours as measured, labels after cleaning, camera
overview.png                      one picture of all of it
recording.rrd                     when asked for
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh

from mapping.folders import staged_folder
from mapping.plain_json import plain
from reconstruction.files.mesh_files import encode_obj, encode_ply, loads_closed
from reconstruction.files.output_folder import (
    RECORDING,
    SCENE,
    check_output,
    check_replaceable,
    written_files,
)
from reconstruction.files.scene_json import OTHER_FOLDER, describe, object_folder, to_json
from reconstruction.files.stored import StoredObject, StoredResult, load_result
from reconstruction.files.stored_frame import write_frame
from reconstruction.pictures.overview import draw_overview

if TYPE_CHECKING:
    from reconstruction.result import Reconstruction

__all__ = ["StoredObject", "StoredResult", "check_output", "load_result", "save_reconstruction"]


def save_reconstruction(
    reconstruction: Reconstruction,
    folder: Path,
    overwrite: bool = False,
    truth: Mapping[int, trimesh.Trimesh] | None = None,
    recording: bool = False,
    stream: Mapping[str, Any] | None = None,
    whole: bool = True,
) -> Path:
    """Write the result folder and return its path.

    Everything is built in a hidden folder beside it and renamed when complete; errors leave what was there.
    truth: label -> true mesh in the world frame, for the overview and the recording.
    stream: what scene.json is to say of the frames that the map grew by; whole: with field.npz and
    overview.png, which cost more time than a map's versions have that follow each other.
    Raises ConfigError when the folder holds something already (see check_output), DataError when
    writing fails.
    """
    folder = check_output(folder, overwrite)
    may_replace = (lambda: check_replaceable(folder)) if overwrite else None
    with staged_folder(folder, may_replace, last=SCENE) as partial:
        _write(reconstruction, partial, truth, recording, whole, stream)
    return folder


def _write(
    reconstruction: Reconstruction,
    folder: Path,
    truth: Mapping[int, trimesh.Trimesh] | None,
    recording: bool,
    whole: bool,
    stream: Mapping[str, Any] | None,
) -> None:
    closed: dict[int, bool] = {}
    for item in reconstruction.objects:
        place = folder / "objects" / object_folder(item.label, item.name)
        place.mkdir(parents=True)
        ply, obj = place / "mesh.ply", place / "mesh.obj"
        ply.write_bytes(encode_ply(item.mesh, item.uncertainty))
        obj.write_bytes(encode_obj(item.mesh))
        # What is promised is what other programs find in the files.
        closed[item.label] = item.watertight and loads_closed(ply) and loads_closed(obj)
    if reconstruction.other is not None:
        place, other = folder / OTHER_FOLDER, reconstruction.other
        place.mkdir(parents=True)
        (place / "mesh.ply").write_bytes(encode_ply(other.mesh, other.uncertainty))
        (place / "mesh.obj").write_bytes(encode_obj(other.mesh))
    reconstruction.map.save(folder / "map.npz")
    write_frame(reconstruction.frame, reconstruction.observation, folder)
    if whole:
        _write_fields(reconstruction, folder / "field.npz")
        draw_overview(reconstruction, folder / "overview.png", truth)
    if recording:
        from reconstruction.pictures.recording import record

        record(reconstruction, folder / RECORDING, truth)
    grown = {} if stream is None else {"stream": plain(dict(stream))}
    scene = {**describe(reconstruction, closed), **grown, "files": written_files(folder)}
    (folder / SCENE).write_text(to_json(scene), encoding="utf-8")


def _write_fields(reconstruction: Reconstruction, path: Path) -> None:
    """Arrays `<quantity>_<label>` of every lattice, and labels (K,) and T_world_table (4, 4)."""
    arrays: dict[str, np.ndarray] = {
        "labels": np.array([item.label for item in reconstruction.fields], np.int64),
        "T_world_table": reconstruction.T_world_table,
    }
    for item in reconstruction.fields:
        arrays[f"origin_{item.label}"] = np.asarray(item.origin, np.float64)
        arrays[f"spacing_{item.label}"] = np.asarray(item.spacing, np.float64)
        arrays[f"occupancy_{item.label}"] = np.asarray(item.occupancy, np.float16)
        arrays[f"uncertainty_{item.label}"] = np.asarray(item.uncertainty, np.float16)
    with path.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)
