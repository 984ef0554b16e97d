"""The scans that `contramap semantic` is given, in one frame: sequences, single scans, clouds, meshes.

Knows paths and readers; must not know maps.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mapping.errors import DataError
from perception.datasets.labelled_clouds import read_cloud
from perception.datasets.labelled_meshes import read_mesh, seen_from, viewpoints
from perception.datasets.semantickitti import KittiSequence
from perception.labelled_cloud import LabelledCloud

VIEWS, RAYS = 8, 15_000
"""Virtual cameras in a mesh, and rays of each."""


def read_scans(paths: tuple[Path, ...], seed: int) -> list[LabelledCloud]:
    """Labelled clouds in one frame.

    A folder is a SemanticKITTI sequence, a .bin one scan of it in the frame of the sequence's first, an .npz
    with vertices a labelled mesh, anything else a labelled cloud as it stands. Raises DataError when the
    classes of two inputs differ, or no point has a label.
    """
    clouds: list[LabelledCloud] = []
    for path in paths:
        clouds += _read(path, seed)
    for cloud in clouds:
        if cloud.names != clouds[0].names:
            raise DataError(f"{cloud.name}: other classes than {clouds[0].name}; map them apart")
    labelled = [cloud.labelled() for cloud in clouds]
    kept = [cloud for cloud in labelled if len(cloud.points)]
    if not kept:
        raise DataError("no point of these scans has a label that is mapped; are the label files there?")
    return kept


def _read(path: Path, seed: int) -> list[LabelledCloud]:
    if path.is_dir():
        sequence = KittiSequence(path)
        return _of_sequence(sequence, sequence.scans())
    if path.suffix == ".bin":
        return _of_sequence(KittiSequence(path.resolve().parents[1]), [path.stem])
    if path.suffix == ".npz":
        from mapping.guarded_files import names_of_npz

        if "vertices" in names_of_npz(path):
            mesh, rng = read_mesh(path), np.random.default_rng(seed)
            return [seen_from(mesh, place, RAYS, rng) for place in viewpoints(mesh, VIEWS, rng)]
    return [read_cloud(path)]


def _of_sequence(sequence: KittiSequence, names: list[str]) -> list[LabelledCloud]:
    every = sequence.scans()
    if names == every[:1]:
        return [sequence.scan(names[0])]
    poses = sequence.poses()
    if len(poses) < len(every):
        raise DataError(f"{sequence.folder / 'poses.txt'}: {len(poses)} poses for {len(every)} scans")
    first = np.linalg.inv(poses[0])
    return [sequence.scan(name, first @ poses[every.index(name)]) for name in names]
