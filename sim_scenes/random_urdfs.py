"""The thousand block figures that ship with pybullet (`random_urdfs`): shapes the prior never learns from."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import trimesh

from mapping.errors import DataError
from sim_scenes.training_shapes import TrainingShape

SCALE = 0.015
"""Metres per unit of the mesh files, as their URDF files say."""


def figures_folder() -> Path | None:
    """The folder of the figures; None when pybullet is not installed."""
    spec = find_spec("pybullet_data")
    folder = Path(spec.origin).parent / "random_urdfs" if spec and spec.origin else None
    return folder if folder is not None and folder.is_dir() else None


def draw_figure(rng: np.random.Generator) -> TrainingShape:
    """One of the figures at its own size; raises DataError when pybullet is not installed."""
    folder = figures_folder()
    if folder is None:
        raise DataError("random_urdfs not found: they come with pybullet (pip install pybullet)")
    mesh = trimesh.Trimesh()
    while len(mesh.faces) == 0:  # a few of the files hold nothing
        name = f"{rng.integers(1000):03d}"
        mesh = trimesh.load_mesh(folder / name / f"{name}.obj", process=True)
    figure = trimesh.Trimesh(mesh.vertices * SCALE, mesh.faces, process=False)
    return TrainingShape("random_urdf", (figure,))
