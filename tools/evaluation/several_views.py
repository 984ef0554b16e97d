"""Methods that map several views: the project's, TSDF fusion, and the union of single-view meshes.

Knows scenes with frames and true shapes, and methods; knows nothing of figures or tables.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import trimesh

from perception.camera import invert_rigid
from perception.frame import Frame

if TYPE_CHECKING:
    from reconstruction.result import Reconstruction
    from reconstruction.solid import Solid

CARD_SPACING = 0.01
"""Voxels on which p(uncertain) is to tell occluded from seen space [m]."""
CARD_RADIUS = 0.15
"""They lie within this distance of true object centres [m]."""
UNCERTAIN_NULL = float("nan")


@dataclass(frozen=True)
class ManyViews:
    """A scene: its frames, and the true shapes [m, world frame] of the judged objects by label."""

    name: str
    frames: list[Frame]
    solids: dict[int, Solid]
    kept: dict[int, Reconstruction] = field(default_factory=dict)

    def alone(self, frame: Frame) -> Reconstruction:
        """The map of one frame, made once."""
        from reconstruction import reconstruct

        if id(frame) not in self.kept:
            self.kept[id(frame)] = reconstruct(frame)
        return self.kept[id(frame)]


@dataclass(frozen=True)
class Answer:
    """One object as a method has it. parts: closed meshes [m, world frame], whose union it is."""

    parts: tuple[trimesh.Trimesh, ...]
    uncertainty: float = UNCERTAIN_NULL


def of_contramap(scene: ManyViews, frames: Sequence[Frame]) -> tuple[dict[int, Answer], float]:
    """The project's map of all views, and how well p(uncertain) tells occluded from seen space."""
    from perception.space import Region
    from reconstruction import reconstruct
    from tools.evaluation.statistics import auroc

    result = reconstruct(frames)
    centres = np.array([solid.mesh.bounds.mean(0) for solid in scene.solids.values()])
    low, high = centres.min(0) - CARD_RADIUS, centres.max(0) + CARD_RADIUS
    axes = [np.arange(a, b, CARD_SPACING) for a, b in zip(low, high)]
    world = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    near = (np.linalg.norm(world[:, None] - centres, axis=2) < CARD_RADIUS).any(1)
    T = invert_rigid(result.T_world_table)
    local = (world[near] @ T[:3, :3].T + T[:3, 3]).astype(np.float32)
    region = result.space.classify(local)
    occluded = region == Region.OCCLUDED
    asked = occluded | (region == Region.FREE) | (region == Region.SURFACE)
    uncertain = result.map.predict_proba(local[asked])[:, -1]
    answers = {item.label: Answer((item.mesh,), item.mean_uncertainty) for item in result}
    return answers, auroc(uncertain, occluded[asked])


def of_tsdf(scene: ManyViews, frames: Sequence[Frame]) -> tuple[dict[int, Answer], float]:
    """Open3D's TSDF fusion of each object's masked depth in all views."""
    from perception.views.joint_space import space_of
    from perception.views.observing_together import observe_together
    from tools.evaluation.fitted_map import View
    from tools.evaluation.tsdf import FittedTsdf

    joint = observe_together(frames)
    view = View(joint.views[0].frame, joint, space_of(joint))
    T_world_table = view.frame.camera.T_world_camera @ invert_rigid(joint.T_table_camera)
    answers = {}
    for item, surface in zip(joint.objects, FittedTsdf(view).meshes(view)):
        if surface is not None:
            mesh = surface.mesh.copy().apply_transform(T_world_table)
            answers[item.label] = Answer((mesh,), float(surface.uncertainty.mean()))
    return answers, float("nan")


def of_union(scene: ManyViews, frames: Sequence[Frame]) -> tuple[dict[int, Answer], float]:
    """The null: every view mapped by itself, meshes of one object taken together."""
    parts: dict[int, list[trimesh.Trimesh]] = {}
    for frame in frames:
        for item in scene.alone(frame):
            parts.setdefault(item.label, []).append(item.mesh)
    return {label: Answer(tuple(of_one)) for label, of_one in parts.items()}, float("nan")


METHODS = {"contramap": of_contramap, "tsdf": of_tsdf, "union": of_union}
