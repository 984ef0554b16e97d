"""What a physics engine gets of all objects: convex parts as far apart as it needs, masses, hidden supports.

Knows the objects, their parts and places in the table frame; knows no format.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from perception.camera import invert_rigid, transform
from reconstruction.export.at_rest import AtRest, at_rest
from reconstruction.export.collision import ConvexParts
from reconstruction.export.export_object import ExportObject
from reconstruction.export.unseen_support import WHY, Block

ALIKE = 0.003
"""Parts no further from a mesh than this stand for it [m]."""


@dataclass(frozen=True)
class Bodies:
    """Label -> convex parts [m] in the object's frame; T_table_object (4, 4) by label. density: [kg/m^3].

    seen_free: which of points (N, 3) [m, table frame] were seen to be empty; None when no support was found.
    """

    objects: tuple[ExportObject, ...]
    parts: Mapping[int, ConvexParts]
    poses: Mapping[int, np.ndarray]
    density: float
    seen_free: Callable[[np.ndarray], np.ndarray] | None
    T_world_table: np.ndarray

    @cached_property
    def unseen_supports(self) -> Mapping[int, tuple[Block, ...]]:
        """Label -> blocks in the table frame that hold up an object which stands on nothing known."""
        return {} if self._at_rest is None else self._at_rest.supports

    @cached_property
    def centres(self) -> dict[int, np.ndarray]:
        """Label -> centre of mass (3,) [m] in the object's frame.

        That of an even density, or where the object does not fall from where it was seen at rest.
        """
        if self._at_rest is None:
            return {item.label: item.inertia(self.density)[1] for item in self.objects}
        return {
            label: transform(invert_rigid(self.poses[label]), centre[None])[0]
            for label, centre in self._at_rest.centres.items()
        }

    @cached_property
    def _at_rest(self) -> AtRest | None:
        """Of all objects, in the table frame; None without a support."""
        if self.seen_free is None:
            return None
        centres = {
            item.label: transform(self.poses[item.label], item.inertia(1.0)[1][None])[0]
            for item in self.objects
        }
        placed = {
            label: tuple(part.moved(self.poses[label]) for part in of_one.parts)
            for label, of_one in self.parts.items()
        }
        return at_rest(placed, centres, self.seen_free)

    @cached_property
    def table_wxyz(self) -> np.ndarray:
        """Unit quaternion w x y z of T_world_table, w >= 0."""
        from scipy.spatial.transform import Rotation

        x, y, z, w = Rotation.from_matrix(self.T_world_table[:3, :3]).as_quat(canonical=True)
        return np.array([w, x, y, z])

    def unseen_blocks(self, label: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Centre (3,) [m], quaternion w x y z and size (3,) [m], in the world frame, of unseen supports."""
        return [
            (transform(self.T_world_table, block.centre[None])[0], self.table_wxyz, block.size)
            for block in self.unseen_supports.get(label, ())
        ]

    def collision_statement(self) -> dict[str, Any]:
        """Number of convex parts of each object and how far they are from its surface [mm].

        decomposition_mm: the larger of both before parts got feet and those of neighbours were kept apart,
        where it is more than ALIKE. centre_moved_mm: how far its centre of mass is from that of an even
        density, to keep it at rest. note: why its parts are coarser than asked for, where they are.
        """
        found: dict[str, Any] = {}
        for item in self.objects:
            parts, even = self.parts[item.label], item.inertia(self.density)[1]
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
        """Which objects stand on fixed blocks, how many, and why."""
        return {
            item.key: {"blocks": len(self.unseen_supports[item.label]), "why": WHY}
            for item in self.objects
            if item.label in self.unseen_supports
        }
