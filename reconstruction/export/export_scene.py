"""What every format may ask of a result: objects in their own frame, poses, convex parts, the frame,
distances.

Knows a stored result; knows no format. What is costly is worked out when first asked for, and once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, get_args

import numpy as np
import trimesh

from mapping.errors import ConfigError
from perception.camera import invert_rigid, transform
from perception.frame import Frame
from reconstruction.export.apart import kept_apart, meshes_beside
from reconstruction.export.at_rest import AtRest, at_rest
from reconstruction.export.collision import CollisionConfig, ConvexParts, Cutter, convex_parts
from reconstruction.export.export_object import ExportObject, moved
from reconstruction.export.footing import with_footing
from reconstruction.export.seen_free import seen_free
from reconstruction.export.unseen_support import WHY, Block
from reconstruction.files.result_folder import StoredResult
from reconstruction.files.scene_json import OTHER_FOLDER, object_folder

ALIKE = 0.003
"""Parts no further from a mesh than this stand for it [m]."""


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

    @cached_property
    def parts(self) -> dict[int, ConvexParts]:
        """Label -> convex parts [m] of the object's solid, in the object's frame."""
        solids, config = [item.solid for item in self.objects], CollisionConfig(self.config.cutter)
        beside = meshes_beside(solids, [self._poses[item.label] for item in self.objects])
        cut = first = convex_parts(solids, config, self._progress, self.config.workers, beside)
        if self.support_found:
            heights = [self._support_height(item) for item in self.objects]
            cut = [with_footing(*of_one) for of_one in zip(cut, solids, heights)]
        apart = self._apart({item.label: parts for item, parts in zip(self.objects, cut)})
        return {
            item.label: replace(apart[item.label], cut=of_one) for item, of_one in zip(self.objects, first)
        }

    @cached_property
    def unseen_supports(self) -> Mapping[int, tuple[Block, ...]]:
        """Label -> blocks in the table frame that hold up an object which stands on nothing known."""
        return self._at_rest.supports if self.support_found else {}

    @cached_property
    def _at_rest(self) -> AtRest:
        """Of all objects, in the table frame."""
        centres = {
            item.label: transform(self._poses[item.label], item.inertia(1.0)[1][None])[0]
            for item in self.objects
        }
        return at_rest(self._placed(self.parts), centres, self._seen_free)

    @cached_property
    def centres(self) -> dict[int, np.ndarray]:
        """Label -> centre of mass (3,) [m] in the object's frame.

        That of an even density, or where the object does not fall from where it was seen at rest.
        """
        if not self.support_found:
            return {item.label: item.inertia(self.config.density)[1] for item in self.objects}
        poses = self._poses
        return {
            label: transform(invert_rigid(poses[label]), centre[None])[0]
            for label, centre in self._at_rest.centres.items()
        }

    def unseen_blocks(self, label: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Centre (3,) [m], quaternion w x y z and size (3,) [m], in the world frame, of unseen supports."""
        return [
            (transform(self.T_world_table, block.centre[None])[0], self.table_wxyz, block.size)
            for block in self.unseen_supports.get(label, ())
        ]

    @cached_property
    def table_wxyz(self) -> np.ndarray:
        """Unit quaternion w x y z of T_world_table, w >= 0."""
        from scipy.spatial.transform import Rotation

        x, y, z, w = Rotation.from_matrix(self.T_world_table[:3, :3]).as_quat(canonical=True)
        return np.array([w, x, y, z])

    def _seen_free(self, points: np.ndarray) -> np.ndarray:
        """Which points (N, 3) [m, table frame] were seen to be empty: (N,) bool."""
        return seen_free(transform(self.T_world_table, points), self.result.frames())

    @property
    def has_parts(self) -> bool:
        """Whether convex parts have been asked for by now."""
        return "parts" in self.__dict__

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

    def _apart(self, parts: dict[int, ConvexParts]) -> dict[int, ConvexParts]:
        """The parts, cut where those of two objects overlap. All z axes are parallel: one frame for all."""
        poses, placed = self._poses, self._placed(parts)
        apart, found = kept_apart(placed), dict(parts)
        for item in self.objects:
            kept = apart[item.label]
            if kept != placed[item.label]:
                own = tuple(moved(part, invert_rigid(poses[item.label])) for part in kept)
                found[item.label] = ConvexParts(own, item.solid, parts[item.label].note)
        return found

    @cached_property
    def _poses(self) -> dict[int, np.ndarray]:
        """Label -> T_table_object (4, 4)."""
        T_table_world = invert_rigid(self.T_world_table)
        return {item.label: T_table_world @ item.T_world_object for item in self.objects}

    def _placed(self, parts: dict[int, ConvexParts]) -> dict[int, tuple[trimesh.Trimesh, ...]]:
        """Label -> convex parts [m] in the table frame."""
        return {
            label: tuple(moved(part, self._poses[label]) for part in of_one.parts)
            for label, of_one in parts.items()
        }

    def collision_statement(self) -> dict[str, Any]:
        """Number of convex parts of each object and how far they are from its surface [mm].

        decomposition_mm: the larger of both before parts got feet and those of neighbours were kept apart,
        where it is more than ALIKE. centre_moved_mm: how far its centre of mass is from that of an even
        density, to keep it at rest. note: why its parts are coarser than asked for, where they are.
        """
        found: dict[str, Any] = {}
        for item in self.objects:
            parts, even = self.parts[item.label], item.inertia(self.config.density)[1]
            shift = float(np.linalg.norm(self.centres[item.label] - even))
            found[item.key] = {
                "parts": len(parts.parts),
                "missing_mm": round(1e3 * parts.missing_m, 2),
                "excess_mm": round(1e3 * parts.excess_m, 2),
                "centre_moved_mm": round(1e3 * shift, 2),
            }
            if parts.error_m > ALIKE and parts.cut is not None:
                found[item.key]["decomposition_mm"] = round(1e3 * parts.cut.error_m, 2)
            if parts.note:
                found[item.key]["note"] = parts.note
        return found

    def unseen_statement(self) -> dict[str, Any]:
        """Which objects stand on fixed blocks, how many, and why; {} before a format has asked for them."""
        found = self.__dict__.get("unseen_supports", {})
        return {
            item.key: {"blocks": len(found[item.label]), "why": WHY}
            for item in self.objects
            if item.label in found
        }

    def _inflated(self) -> dict[int, trimesh.Trimesh]:
        """Label -> mesh [m, world frame] of what may be occupied; {} unless asked for."""
        if self.config.inflate is None:
            return {}
        from reconstruction.inflate import inflated_meshes

        return inflated_meshes(self.result, self.config.inflate)
