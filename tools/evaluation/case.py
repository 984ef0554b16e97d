"""One scene as the evaluation sees it: what the camera observed and what truly stands there, in one frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from zlib import crc32

import numpy as np
import trimesh

from mapping.errors import DataError
from perception import load_frame
from perception.camera import invert_rigid
from perception.frame import Frame
from perception.observation import Observation
from perception.observing import observe
from perception.space import Region, Space
from reconstruction.solid import Solid
from sim_scenes.truth import load_truth
from tools.evaluation.fitted_map import View

LEAST_PIXELS = 200
"""Objects that show fewer pixels are not judged."""
CARD_SPACING = 0.01
"""Voxels of the uncertainty card [m]."""
CARD_RADIUS = 0.15
"""The card covers this distance around true object centres [m]."""
UNSEEN = -1
"""True class of a voxel inside an object that perception did not deliver: no answer is right there."""


@dataclass(frozen=True)
class CardVoxels:
    """Voxels above the table near true objects. points: (N, 3) [m, table frame]; truth: (N,) class index,
    0 empty, k the k-th observed object, UNSEEN; occluded, seen: (N,) bool, both false out of view."""

    points: np.ndarray
    truth: np.ndarray
    occluded: np.ndarray
    seen: np.ndarray


@dataclass(frozen=True)
class Case:
    """A frame, its observation, and the true meshes [m] by label, in the table frame."""

    name: str
    frame: Frame
    observation: Observation
    space: Space
    meshes: dict[int, trimesh.Trimesh]

    @property
    def view(self) -> View:
        """What a method may know of it."""
        return View(self.frame, self.observation, self.space)

    @cached_property
    def judged(self) -> list[int]:
        """Labels of the objects that count: enough labelled pixels in this view."""
        assert self.frame.labels is not None
        pixels = np.bincount(self.frame.labels.ravel(), minlength=max(self.meshes) + 1)
        return [label for label in sorted(self.meshes) if pixels[label] >= LEAST_PIXELS]

    @cached_property
    def index_of(self) -> dict[int, int]:
        """Label -> position among the observed objects."""
        return {item.label: index for index, item in enumerate(self.observation.objects)}

    @cached_property
    def solids(self) -> dict[int, Solid]:
        """The true meshes by label, ready for questions."""
        return {label: Solid(mesh) for label, mesh in self.meshes.items()}

    def rng(self, seed: int, purpose: str) -> np.random.Generator:
        """A generator that depends on this scene, the seed and the purpose alone, wherever it is run."""
        return np.random.default_rng([crc32(self.name.encode()), seed, crc32(purpose.encode())])

    @cached_property
    def card_voxels(self) -> CardVoxels:
        """Voxels on which uncertainty is judged."""
        centres = np.array([mesh.bounds.mean(0) for mesh in self.meshes.values()])
        low, high = centres.min(0) - CARD_RADIUS, centres.max(0) + CARD_RADIUS
        if self.observation.support is not None:
            low[2] = 0.0
        axes = [np.arange(a + CARD_SPACING / 2, b, CARD_SPACING) for a, b in zip(low, high)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3).astype(np.float32)
        near = np.zeros(len(points), bool)
        for centre in centres.astype(np.float32):
            near |= ((points - centre) ** 2).sum(1) <= CARD_RADIUS**2
        points = points[near]
        truth = np.zeros(len(points), np.int64)
        for label, solid in self.solids.items():
            truth[solid.inside(points)] = self.index_of.get(label, UNSEEN - 1) + 1
        region = self.space.classify(points)
        seen = (region == Region.FREE) | (region == Region.SURFACE)
        return CardVoxels(points, truth, region == Region.OCCLUDED, seen)


def load_case(folder: Path, ycb_dir: Path | None = None) -> Case:
    """Read a scene folder's first view and its truth. Raises DataError or FrameError."""
    truth = load_truth(folder, ycb_dir)
    frame = load_frame(truth.views[0])
    if frame.labels is None:
        raise DataError(f"{folder}: the evaluation needs labels.png")
    observation = observe(frame)
    T_table_world = observation.T_table_camera @ invert_rigid(frame.camera.T_world_camera)
    meshes = {}
    for label, mesh in truth.meshes.items():
        meshes[label] = mesh.copy()
        meshes[label].apply_transform(T_table_world)
    return Case(folder.name, frame, observation, Space.of(observation), meshes)
