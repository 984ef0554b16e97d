"""The arrays of a map of kernels of several shapes as one .npz file.

Knows names and shapes of arrays; must not know how they answer.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from mapping.errors import DataError
from mapping.files import temporary_beside
from mapping.guarded_files import read_npz
from mapping.hashed_hinges import HashedHinges, hinges_at

FORMAT = 2
"""1 was a map of kernels of one shape, in stretched coordinates."""
ARRAYS = {"spacings": 2, "nodes": 2, "first": 1, "amplitude": 1, "kernel": 1, "W": 2, "known": 1}
"""Names and dimensions. kernel: width and cutoff; known: the classes that have columns in W."""


def write_hinges(path: Path, hinges: HashedHinges, W: np.ndarray, known: np.ndarray, classes: int) -> None:
    """Write hinge points, weights W (H, C) and the classes known (C or C - 1,) to one file, or none."""
    with temporary_beside(path) as partial, partial.open("wb") as file:
        np.savez(
            file,
            format=FORMAT,
            spacings=hinges.spacings,
            nodes=hinges.nodes,
            first=hinges.first,
            amplitude=hinges.amplitude,
            kernel=np.array([hinges.width, hinges.cutoff]),
            W=W,
            known=known,
            classes=classes,
        )


def read_hinges(path: Path) -> tuple[HashedHinges, np.ndarray, np.ndarray, int]:
    """What `write_hinges` was given. Raises DataError for missing, other or broken files."""
    values = read_npz(path)
    if "format" not in values or values["format"].size != 1 or values["format"] != FORMAT:
        raise DataError(f"{path}: no map of several shapes of kernels of format {FORMAT}; make it again")
    for name, dimensions in ARRAYS.items():
        if name not in values or values[name].ndim != dimensions or not np.isfinite(values[name]).all():
            raise DataError(f"{path}: {name} is missing or damaged; make the map again")
    first, nodes, W = values["first"].astype(np.int64), values["nodes"], values["W"].astype(np.float32)
    shapes = len(values["spacings"])
    sized = len(first) == shapes + 1 and len(values["amplitude"]) == shapes and len(nodes) == len(W)
    known, classes = values["known"].astype(np.int64), int(values.get("classes", 0))
    sized &= W.shape[1] - len(known) in (0, 1) and len(known) > 0
    sized = sized and known.min() >= 0 and known.max() < classes
    if not sized or first[0] != 0 or first[-1] != len(nodes) or (np.diff(first) < 0).any():
        raise DataError(f"{path}: its arrays do not fit each other; make the map again")
    parts = [nodes[a:b] for a, b in pairwise(first)]
    width, cutoff = (float(value) for value in values["kernel"])
    return hinges_at(parts, values["spacings"], values["amplitude"], width, cutoff), W, known, classes
