"""What a reconstruction is: a mesh with uncertainty per object, the map behind it, and its diagnostics."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh

from mapping.errors import ConfigError
from perception.camera import invert_rigid
from perception.frame import Frame
from perception.observation import NOTHING, OTHER, Observation, Skipped
from perception.space import Space
from perception.views.joint import JointObservation
from perception.views.joint_space import space_of
from reconstruction.lookup import count, find, names
from reconstruction.query import Query, ask_world
from reconstruction.surface.agreement import Agreement, agreement_with_depth, together

if TYPE_CHECKING:
    from mapping.contramap import ContraMap
    from reconstruction.distance import DistanceField, Distances


SENSOR_TOLERANCE = 0.005
"""Meshes are compared with a depth image, whatever sensor it comes from, to this [m]."""


@dataclass(frozen=True, repr=False)
class ReconstructedObject:
    """One object's surface with uncertainty, in the world frame.

    mesh: watertight trimesh [m]; its export("x.ply") keeps uncertainty and colours, other formats may not;
    uncertainty: (V,) float32 p(uncertain) in [0, 1] at each vertex; class_index: the object's column in the
    map's probabilities (1-based; 0 is empty space);
    T_world_object: (4, 4) pose of the object's box: origin at its centre, z along the support normal;
    extents: (3,) box size [m] along the axes of T_world_object.
    """

    label: int
    name: str
    class_index: int
    mesh: trimesh.Trimesh
    uncertainty: np.ndarray
    T_world_object: np.ndarray
    extents: np.ndarray

    @property
    def mean_uncertainty(self) -> float:
        return float(self.uncertainty.mean())

    @property
    def watertight(self) -> bool:
        return bool(self.mesh.is_watertight and self.mesh.is_winding_consistent)

    def save(self, path: str | Path) -> Path:
        """Write the mesh, as the result folder has it: .ply in double precision with uncertainty and colours,
        or .obj. Returns the path. Raises ConfigError for another ending, DataError when writing fails."""
        from reconstruction.files.mesh_files import write_mesh

        write_mesh(self.mesh, self.uncertainty, Path(path))
        return Path(path)

    def __repr__(self) -> str:
        size = " x ".join(f"{1e3 * side:.0f}" for side in self.extents)
        return (
            f"ReconstructedObject({self.label} {self.name}, {size} mm, {len(self.mesh.vertices)} vertices, "
            f"mean uncertainty {self.mean_uncertainty:.2f})"
        )


@dataclass(frozen=True)
class ObjectField:
    """The map on the lattice around one object, in the table frame.

    Node (i, j, k) lies at origin + spacing * (i, j, k). origin: (3,) [m]; spacing [m];
    occupancy: (nx, ny, nz) P(this object) among the classes other than uncertain;
    uncertainty: (nx, ny, nz) p(uncertain).
    """

    label: int
    origin: np.ndarray
    spacing: float
    occupancy: np.ndarray
    uncertainty: np.ndarray


@dataclass(frozen=True)
class OtherObstacles:
    """What was measured near objects and carries no label, as one surface in the world frame.

    mesh: closed trimesh [m]; uncertainty: (V,) float32 p(uncertain) in [0, 1] at each vertex; class_index:
    its column in the map's probabilities, after the objects'.
    """

    mesh: trimesh.Trimesh
    uncertainty: np.ndarray
    class_index: int

    @property
    def mean_uncertainty(self) -> float:
        return float(self.uncertainty.mean())


@dataclass(frozen=True, repr=False)
class Reconstruction:
    """Objects, the fitted map, and what happened on the way.

    map lives in the table frame; T_world_table (4, 4) leads to the world frame of all meshes.
    samples: (N, 3) float32 [m, table frame] with sample_classes (N,): 0 empty, k object k, last uncertain.
    timings_ms: stage -> milliseconds. config: everything that was used, as plain dict.
    fields: the lattices the meshes were taken from, one an object. floor: no object is below this height
    [m, table frame], whatever the map says there; None: unknown. other: obstacles without a label, None if
    there are none near objects. updater: makes the map of one view more, see update.
    """

    frame: Frame
    observation: Observation
    objects: tuple[ReconstructedObject, ...]
    map: ContraMap
    T_world_table: np.ndarray
    samples: np.ndarray
    sample_classes: np.ndarray
    timings_ms: dict[str, float]
    skipped: tuple[Skipped, ...] = ()
    notes: tuple[str, ...] = ()
    fields: tuple[ObjectField, ...] = ()
    config: dict[str, Any] = field(default_factory=dict)
    seed: int = 0
    floor: float | None = None
    other: OtherObstacles | None = None
    updater: Callable[[Reconstruction, Frame, bool, int | None], Reconstruction] | None = None

    @cached_property
    def space(self) -> Space:
        """What the frame says of space: free, occluded, unseen."""
        return space_of(self.observation)

    @cached_property
    def agreement(self) -> dict[int, Agreement]:
        """What the frame, as it was given, says of each object's mesh, by label. Measured when asked for."""
        if isinstance(self.observation, JointObservation):
            return self._agreement_of_views(self.observation)
        frame = self.frame
        labels = own = self.observation.labels
        if frame.labels is not None:  # numbers of further things of one label are the largest
            labels = np.where(own > frame.labels.max(), own, frame.labels)
        meshes = {item.label: item.mesh for item in self.objects}
        T_camera_world = invert_rigid(frame.camera.T_world_camera)
        return agreement_with_depth(
            meshes, labels, frame.depth, frame.camera, T_camera_world, SENSOR_TOLERANCE
        )

    def _agreement_of_views(self, observation: JointObservation) -> dict[int, Agreement]:
        """What all views that were used say of each object's mesh, each pixel counting once."""
        meshes = {item.label: item.mesh for item in self.objects}
        found = []
        for view in observation.views:
            assert view.frame.labels is not None
            T_world_camera = self.T_world_table @ view.observation.T_table_camera
            found.append(
                agreement_with_depth(
                    meshes,
                    view.frame.labels,
                    view.frame.depth,
                    view.frame.camera,
                    invert_rigid(T_world_camera),
                    SENSOR_TOLERANCE,
                )
            )
        return {label: together([of_view[label] for of_view in found]) for label in meshes}

    @property
    def contradictions(self) -> list[str]:
        """A line of warning for each object whose mesh contradicts its depth image."""
        return [
            f"warning: the mesh of {item.label} {item.name} contradicts the depth image: "
            f"{found.agreement:.0%} of its pixels agree within {1e3 * found.tolerance:.0f} mm, "
            f"{found.early_rays:.1%} as many rays are stopped too early"
            for item in self.objects
            if (found := self.agreement[item.label]).contradicts
        ]

    @property
    def map_labels(self) -> tuple[int, ...]:
        """The label of each of the map's columns: 0 empty, the objects, -2 other obstacles, -1 uncertain.

        An observed object has its column even where it got no mesh.
        """
        labels = [item.label for item in self.observation.objects]
        others = [OTHER] * (len(self.map.offset) - 2 - len(labels))
        return (0, *labels, *others, NOTHING)

    def query(self, points: np.ndarray) -> Query:
        """What is at points (N, 3) [m] in the world frame: see Query for the codes of its labels.

        Raises DataError for points of another shape, NaN and infinite values.
        """
        return ask_world(self.map, self.observation, self.space, self.floor, self.T_world_table, points)

    def save(self, folder: str | Path, overwrite: bool = False) -> Path:
        """Write the result folder, as `contramap map` does, and return its path; see save_reconstruction."""
        from reconstruction.files.result_folder import save_reconstruction

        return save_reconstruction(self, Path(folder), overwrite)

    def update(self, frame: Frame, track: bool = False, keep: int | None = None) -> Reconstruction:
        """The map of the scene with one view more, its T_world_camera in the same world.

        As reconstruct with all views, but earlier views are not cleaned again and the fit starts from this
        map's weights; this Reconstruction stays as it is. track: label numbers are the same objects' as here;
        else they are where names agree too, and the rest is matched by place. keep: at most so many views
        are kept, so that time and memory of many updates stay as they are; of more, the one taken nearest to
        another is forgotten. Raises FrameError when the frame shows no usable object.
        """
        if self.updater is None:
            raise ConfigError("this Reconstruction was put together by hand: reconstruct all frames instead")
        return self.updater(self, frame, track, keep)

    def __getitem__(self, key: str | int) -> ReconstructedObject:
        """The object of this name or label; DataError that names the valid ones."""
        return find(self.objects, key)

    def __iter__(self) -> Iterator[ReconstructedObject]:
        return iter(self.objects)

    def __repr__(self) -> str:
        skipped = f"; {len(self.skipped)} skipped" if self.skipped else ""
        took = f"; {self.timings_ms['total'] / 1e3:.2f} s" if "total" in self.timings_ms else ""
        return f"Reconstruction({count(self.objects, 'object')}: {names(self.objects)}{skipped}{took})"

    def distance(self, points: np.ndarray, label: int | None = None) -> Distances:
        """Signed distance, its gradient and "unknown" at points (N, 3) [m, world frame].

        To the nearest surface of any object, or of the one with `label`. The first call builds a lattice (a
        second or less), later ones read it: 100,000 points in some 20 ms. Raises ConfigError for a label
        that no object has, DataError for points of another shape or NaN.
        """
        if label not in self._distance_fields:
            from reconstruction.distance import distance_to

            meshes = {item.label: item.mesh for item in self.objects}
            self._distance_fields[label] = distance_to(meshes, label, self.T_world_table, self.map)
        return self._distance_fields[label](points)

    @cached_property
    def _distance_fields(self) -> dict[int | None, DistanceField]:
        return {}
