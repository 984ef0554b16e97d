"""A result folder read back. Knows the folder and its scene.json; nothing of how a result is made."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh

from mapping.errors import ContraMapError, DataError
from mapping.guarded_files import read_json
from perception.frame import Frame
from perception.observation import Observation
from perception.space import Space
from perception.views.joint_space import space_of
from perception.views.observing_together import observe_again
from reconstruction.config import pipeline_of
from reconstruction.files.mesh_files import decode_ply
from reconstruction.files.scene_json import FORMAT
from reconstruction.files.stored_frame import read_frame, read_views
from reconstruction.lookup import count, find, names
from reconstruction.query import Query, ask_world

if TYPE_CHECKING:
    from mapping.contramap import ContraMap
    from reconstruction.distance import DistanceField, Distances


@dataclass(frozen=True, repr=False)
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

    @property
    def mean_uncertainty(self) -> float:
        return float(self.uncertainty.mean())

    def __repr__(self) -> str:
        return f"StoredObject({self.label} {self.name}, {self.folder})"


@dataclass(frozen=True, repr=False)
class StoredResult:
    """A result folder read back; scene is the whole of scene.json."""

    folder: Path
    scene: dict[str, Any]
    objects: tuple[StoredObject, ...]

    def frame(self) -> Frame:
        """The frame the result was made from; raises DataError when it is missing or damaged."""
        return read_frame(self.folder)

    def frames(self) -> list[Frame]:
        """All views that it was made from, the frame alone where there is one; raises DataError as frame."""
        return read_views(self.folder, len(self.scene.get("views", [None])))

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

    def query(self, points: np.ndarray) -> Query:
        """What is at points (N, 3) [m] in the world frame, as Reconstruction.query.

        The stored frame is observed again on the first call: it says what was seen, the map the rest.
        Raises DataError for points of another shape, and where map, frame and settings do not fit.
        """
        model, observation, space = self._asked
        return ask_world(model, observation, space, self.scene["floor"], self.T_world_table, points)

    @cached_property
    def _asked(self) -> tuple[ContraMap, Observation, Space]:
        try:
            config = pipeline_of(self.scene["config"])
            columns, seed = list(self.scene["map_labels"]), int(self.scene["seed"])
        except (KeyError, TypeError, ValueError, ContraMapError) as error:
            raise DataError(
                f"{self.folder / 'scene.json'}: its settings cannot be used ({error}); map the frame again"
            ) from error
        observation = observe_again(self.frames(), config.perception, seed, self.T_world_table)
        if [item.label for item in observation.objects] != [label for label in columns if label > 0]:
            raise DataError(f"{self.folder}: its frame shows other objects than its map; map the frame again")
        return self.map(), observation, space_of(observation, config.perception)

    def __getitem__(self, key: str | int) -> StoredObject:
        """The object of this name or label; DataError that names the valid ones."""
        return find(self.objects, key)

    def __iter__(self) -> Iterator[StoredObject]:
        return iter(self.objects)

    def __repr__(self) -> str:
        return f"StoredResult({count(self.objects, 'object')}: {names(self.objects)}; {self.folder})"


def load_result(folder: str | Path) -> StoredResult:
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
