"""The labelled scenes that semantic maps are measured on: SemanticKITTI scans, a SceneNet room, a house.

Knows where the data lie in --data; must not know methods or protocols.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mapping.errors import ConfigError, DataError
from perception.datasets.labelled_meshes import read_mesh, seen_from, viewpoints
from perception.datasets.semantickitti import KittiSequence
from perception.labelled_cloud import LabelledCloud

SEQUENCES = tuple(f"{number:02d}" for number in range(10))
MESHES = {"scenenet": "scenenet/room_89_simple.npz", "house": "aws_worlds/small_house.npz"}
DATASETS = ("semantickitti", *MESHES)
VIEWS = 8
"""Virtual cameras in a mesh: the first half is mapped, the other half are the next views."""
RAYS = 15_000
"""Rays of a virtual camera."""


@dataclass(frozen=True, eq=False)
class Scene:
    """first: the clouds that are mapped; following: later clouds of the same place, in the same frame."""

    name: str
    first: list[LabelledCloud]
    following: list[LabelledCloud]

    @property
    def X(self) -> np.ndarray:
        """(N, 3) labelled points [m] of the first clouds."""
        return np.concatenate([cloud.points for cloud in self.first])

    @property
    def y(self) -> np.ndarray:
        """(N,) their classes."""
        return np.concatenate([cloud.labels for cloud in self.first])

    @property
    def classes(self) -> int:
        """Number of classes the data set knows."""
        return len(self.first[0].names)


def scene_names(dataset: str, sequences: tuple[str, ...]) -> tuple[str, ...]:
    """Names of a data set's scenes. Raises ConfigError for an unknown data set."""
    if dataset not in DATASETS:
        raise ConfigError(f"--dataset {dataset}: choose from {', '.join(DATASETS)}")
    return (sequences or SEQUENCES) if dataset == "semantickitti" else (dataset,)


def load_scene(data: Path, dataset: str, name: str) -> Scene:
    """One scene. Raises DataError when it is not under `data`, or broken."""
    if dataset != "semantickitti":
        return _seen_mesh(data / MESHES[dataset], name)
    folder = data / "sequences" / name if (data / "sequences").is_dir() else data / name
    if not folder.is_dir():
        raise DataError(
            f"{folder}: no such sequence; --data must name the folder that holds sequences/{name}"
        )
    sequence = KittiSequence(folder)
    scans = sequence.scans()
    first = sequence.scan(scans[0]).labelled()
    if len(scans) == 1:
        return Scene(name, [first], [])
    poses = sequence.poses()
    if len(poses) < len(scans):
        raise DataError(f"{folder / 'poses.txt'}: {len(poses)} poses for {len(scans)} scans")
    to_first = np.linalg.inv(poses[0]) @ poses
    later = [sequence.scan(scan, to_first[i]).labelled() for i, scan in enumerate(scans) if i > 0]
    return Scene(name, [first], later)


def _seen_mesh(path: Path, name: str) -> Scene:
    mesh, rng = read_mesh(path), np.random.default_rng(0)
    views = [seen_from(mesh, place, RAYS, rng) for place in viewpoints(mesh, VIEWS, rng)]
    return Scene(name, views[: VIEWS // 2], views[VIEWS // 2 :])
