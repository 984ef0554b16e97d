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
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh

from mapping.errors import DataError
from mapping.folders import staged_folder
from mapping.guarded_files import read_json
from perception.frame import Frame
from reconstruction.files.mesh_files import decode_ply, encode_obj, encode_ply, loads_closed
from reconstruction.files.output_folder import (
    RECORDING,
    SCENE,
    check_output,
    check_replaceable,
    written_files,
)
from reconstruction.files.scene_json import FORMAT, OTHER_FOLDER, describe, object_folder, to_json
from reconstruction.files.stored_frame import read_frame, write_frame
from reconstruction.pictures.overview import draw_overview
from reconstruction.result import Reconstruction

if TYPE_CHECKING:
    from mapping.contramap import ContraMap
    from reconstruction.distance import DistanceField, Distances


@dataclass(frozen=True)
class StoredObject:
    """One object read back: mesh [m, world frame], uncertainty (V,), pose and extents as in scene.json.

    class_index: the object's column in the map's probabilities.
    """

    label: int
    name: str
    mesh: trimesh.Trimesh
    uncertainty: np.ndarray
    T_world_object: np.ndarray
    extents: np.ndarray
    folder: Path
    class_index: int


@dataclass(frozen=True)
class StoredResult:
    """A result folder read back; scene is the whole of scene.json."""

    folder: Path
    scene: dict[str, Any]
    objects: tuple[StoredObject, ...]

    def frame(self) -> Frame:
        """The frame the result was made from; raises DataError when it is missing or damaged."""
        return read_frame(self.folder)

    def map(self) -> ContraMap:
        """The fitted map, in the table frame."""
        from mapping.model_io import load_map

        return load_map(self.folder / "map.npz")

    @property
    def T_world_table(self) -> np.ndarray:
        """(4, 4) from the table frame, whose z axis is the support's normal, to the world frame of all
        meshes."""
        return np.array(self.scene["T_world_table"], float).reshape(4, 4)

    def distance(self, points: np.ndarray, label: int | None = None) -> Distances:
        """As Reconstruction.distance; needs the stored map."""
        if label not in self._distance_fields:
            from reconstruction.distance import distance_to

            meshes = {item.label: item.mesh for item in self.objects}
            field = distance_to(meshes, label, self.T_world_table, self.map())
            self._distance_fields[label] = field
        return self._distance_fields[label](points)

    @cached_property
    def _distance_fields(self) -> dict[int | None, DistanceField]:
        return {}


def save_reconstruction(
    reconstruction: Reconstruction,
    folder: Path,
    overwrite: bool = False,
    truth: Mapping[int, trimesh.Trimesh] | None = None,
    recording: bool = False,
) -> Path:
    """Write the result folder and return its path.

    Everything is built in a hidden folder beside it and renamed when complete; errors leave what was there.
    truth: label -> true mesh in the world frame, for the overview and the recording.
    Raises ConfigError when the folder holds something already (see check_output), DataError when
    writing fails.
    """
    folder = check_output(folder, overwrite)
    may_replace = (lambda: check_replaceable(folder)) if overwrite else None
    with staged_folder(folder, may_replace, last=SCENE) as partial:
        _write(reconstruction, partial, truth, recording)
    return folder


def load_result(folder: Path) -> StoredResult:
    """Read scene.json and all meshes; raises DataError when one is missing, cut short or not a result."""
    folder = Path(folder)
    path = folder / "scene.json"
    if not path.is_file():
        raise DataError(
            f"{folder}: not a result folder (no scene.json); `contramap map FRAME --out DIR` makes one"
        )
    scene = read_json(path, "map the frame again")
    if not isinstance(scene, dict) or scene.get("format") != FORMAT:
        raise DataError(f"{path}: not a scene.json of this version (format {FORMAT}); map the frame again")
    try:
        objects = tuple(_load_object(folder, entry, k) for k, entry in enumerate(scene["objects"], 1))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise DataError(
            f"{path}: an object's entry is incomplete ({error!r}); map the frame again"
        ) from error
    return StoredResult(folder, scene, objects)


def _write(
    reconstruction: Reconstruction,
    folder: Path,
    truth: Mapping[int, trimesh.Trimesh] | None,
    recording: bool,
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
    _write_fields(reconstruction, folder / "field.npz")
    write_frame(reconstruction.frame, reconstruction.observation, folder)
    draw_overview(reconstruction, folder / "overview.png", truth)
    if recording:
        from reconstruction.pictures.recording import record

        record(reconstruction, folder / RECORDING, truth)
    scene = {**describe(reconstruction, closed), "files": written_files(folder)}
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


def _load_object(folder: Path, entry: dict[str, Any], number: int) -> StoredObject:
    path = folder / str(entry["mesh"])
    if not path.resolve().is_relative_to(folder.resolve()):
        raise DataError(f"{folder / 'scene.json'}: mesh path {entry['mesh']!r} leaves the result folder")
    mesh, uncertainty = decode_ply(path)
    return StoredObject(
        label=int(entry["label"]),
        name=str(entry["name"]),
        mesh=mesh,
        uncertainty=uncertainty,
        T_world_object=np.array(entry["T_world_object"], float).reshape(4, 4),
        extents=np.array(entry["extents"], float).reshape(3),
        folder=path.parent,
        class_index=int(entry.get("class_index", number)),
    )
