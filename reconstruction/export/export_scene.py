"""What every format may ask of a result: objects in their own frame, poses, convex parts, the frame,
distances.

Knows a stored result; knows no format. What is costly is worked out when first asked for, and once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import get_args

import numpy as np
import trimesh

from mapping.errors import ConfigError
from perception.camera import invert_rigid, transform
from perception.frame import Frame
from reconstruction.export.apart import Parts, kept_apart, meshes_beside
from reconstruction.export.bodies import Bodies
from reconstruction.export.carving import carved
from reconstruction.export.collision import CollisionConfig, ConvexParts, Cutter, convex_parts
from reconstruction.export.export_object import ExportObject, moved
from reconstruction.export.footing import with_footing
from reconstruction.export.put_back import put_back
from reconstruction.export.seen_free import seen_free
from reconstruction.files.result_folder import StoredResult
from reconstruction.files.scene_json import OTHER_FOLDER, object_folder


@dataclass(frozen=True)
class ExportConfig:
    """What exports can be told."""

    density: float = 500.0
    """Mass per volume of the objects [kg/m^3]: a filled box of groceries."""
    friction: float = 0.8
    """Coefficient of friction written for the objects."""
    inflate: float | None = None
    """Collision shapes and distances take in whatever is occupied with more than this probability (0..1);
    None: the meshes as they are."""
    rolling: float = 0.002
    """Friction against rolling [m]: round things that were seen at rest do not roll away."""
    cutter: Cutter = "halves"
    """What makes the first cuts into convex parts: halvings, or CoACD, which takes longer."""
    workers: int | None = None
    """Processes that cut objects at a time; None: one a core. The files do not depend on it."""


class ExportScene:
    """A stored result, ready to be written in any format. progress: called after each object that was cut."""

    def __init__(
        self,
        result: StoredResult,
        config: ExportConfig | None = None,
        progress: Callable[[], None] = lambda: None,
    ) -> None:
        self.result = result
        self.config = config or ExportConfig()
        if not self.config.density > 0:
            raise ConfigError(f"density must be > 0 kg/m^3, got {self.config.density:g}")
        if self.config.inflate is not None and not 0 < self.config.inflate < 1:
            raise ConfigError(f"inflate is a probability between 0 and 1, got {self.config.inflate:g}")
        if self.config.cutter not in (cutters := get_args(Cutter)):
            raise ConfigError(f"cutter is one of {', '.join(cutters)}, got {self.config.cutter!r}")
        if self.config.workers is not None and self.config.workers < 1:
            raise ConfigError(f"workers must be at least 1, got {self.config.workers}")
        self._progress = progress
        self._bodies: dict[float, Bodies] = {}

    @cached_property
    def objects(self) -> tuple[ExportObject, ...]:
        """The objects in the order of scene.json."""
        inflated = self._inflated()
        found = []
        for item in self.result.objects:
            T_object_world = invert_rigid(item.T_world_object)
            mesh = moved(item.mesh, T_object_world)
            key = object_folder(item.label, item.name)
            solid = moved(inflated[item.label], T_object_world) if item.label in inflated else mesh
            found.append(
                ExportObject(key, item.label, item.name, mesh, solid, item.T_world_object, item.extents)
            )
        return tuple(found)

    @cached_property
    def obstacles(self) -> tuple[ExportObject, ...]:
        """The objects, and as one more with label 0 and the key `other` what stands near them without a
        label."""
        from reconstruction.files.mesh_files import decode_ply

        if self.result.scene.get("other") is None:
            return self.objects
        mesh, _ = decode_ply(self.result.folder / OTHER_FOLDER / "mesh.ply")
        T = self.T_world_table
        local = moved(mesh, invert_rigid(T))
        return (*self.objects, ExportObject("other", 0, "other", local, local, T, local.extents))

    def bodies(self, gap: float) -> Bodies:
        """What physics formats write, parts of different objects no nearer than `gap` [m]."""
        if gap not in self._bodies:
            seen_free = self._seen_free if self.support_found else None
            self._bodies[gap] = Bodies(
                self.objects,
                self._apart(gap),
                self._poses,
                self.config.density,
                seen_free,
                self.T_world_table,
            )
        return self._bodies[gap]

    @cached_property
    def _footed(self) -> dict[int, ConvexParts]:
        """Label -> convex parts [m] of the object's solid with feet on the support, in the object's frame."""
        solids, config = [item.solid for item in self.objects], CollisionConfig(self.config.cutter)
        beside = meshes_beside(solids, [self._poses[item.label] for item in self.objects])
        cut = first = convex_parts(solids, config, self._progress, self.config.workers, beside)
        if self.support_found:
            heights = [self._support_height(item) for item in self.objects]
            cut = [with_footing(*of_one) for of_one in zip(cut, solids, heights)]
        return {
            item.label: replace(footed, cut=of_one) for item, footed, of_one in zip(self.objects, cut, first)
        }

    def _seen_free(self, points: np.ndarray) -> np.ndarray:
        """Which points (N, 3) [m, table frame] were seen to be empty: (N,) bool."""
        return seen_free(transform(self.T_world_table, points), self.result.frames())

    @cached_property
    def frame(self) -> Frame:
        """The frame the result was made from."""
        return self.result.frame()

    @property
    def T_world_table(self) -> np.ndarray:
        """(4, 4) from the table frame to the world frame."""
        return self.result.T_world_table

    @property
    def support_found(self) -> bool:
        """Whether the table frame's z = 0 is a support plane."""
        return self.result.scene.get("support_plane") is not None

    @property
    def up(self) -> np.ndarray:
        """Unit vector (3,) in the world frame against gravity: the support's normal, or z."""
        return self.T_world_table[:3, 2] if self.support_found else np.array([0.0, 0.0, 1.0])

    def _support_height(self, item: ExportObject) -> float:
        """z of the support plane in an object's frame [m]: the z axes are parallel."""
        return float((invert_rigid(item.T_world_object) @ self.T_world_table)[2, 3])

    def _apart(self, gap: float) -> dict[int, ConvexParts]:
        """The parts, cut where those of two objects are nearer than `gap` [m]. All z axes are parallel: one
        frame for all."""
        poses, placed, found = self._poses, self._placed, dict(self._footed)
        whole: Mapping[int, Parts] = placed
        meshes = {item.label: moved(item.solid, poses[item.label]) for item in self.objects}
        if gap > 0 and self.config.inflate is None:  # inflated meshes overlap: both would lose all of that
            whole = carved(placed, meshes, gap)
        apart = put_back(kept_apart(whole, gap), whole, meshes, gap)
        for label, kept in apart.items():
            if kept != placed[label]:
                own = tuple(part.moved(invert_rigid(poses[label])) for part in kept)
                found[label] = ConvexParts(own, found[label].mesh, found[label].note, found[label].cut)
        return found

    @cached_property
    def _poses(self) -> dict[int, np.ndarray]:
        """Label -> T_table_object (4, 4)."""
        T_table_world = invert_rigid(self.T_world_table)
        return {item.label: T_table_world @ item.T_world_object for item in self.objects}

    @cached_property
    def _placed(self) -> dict[int, Parts]:
        """Label -> convex parts [m] in the table frame."""
        return {
            label: tuple(part.moved(self._poses[label]) for part in of_one.parts)
            for label, of_one in self._footed.items()
        }

    def _inflated(self) -> dict[int, trimesh.Trimesh]:
        """Label -> mesh [m, world frame] of what may be occupied; {} unless asked for."""
        if self.config.inflate is None:
            return {}
        from reconstruction.inflate import inflated_meshes

        return inflated_meshes(self.result, self.config.inflate)
