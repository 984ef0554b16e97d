"""The thousand block figures that ship with pybullet (`random_urdfs`): shapes the prior never learns from."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np

from mapping.errors import DataError
from sim_scenes.objects.object_model import ObjectModel, load_model
from sim_scenes.training.shapes import TrainingShape

COUNT = 1000
"""Figures, in folders 000 to 999; a few of the files hold nothing."""
SCALE = 0.015
"""Metres per unit of the mesh files, as their URDF files say."""
CONVEX_SHARE = 0.97
"""Pieces that fill this share of their convex hulls serve as parts for the physics as they are."""


def figures_folder() -> Path | None:
    """The folder of the figures; None when pybullet is not installed."""
    spec = find_spec("pybullet_data")
    folder = Path(spec.origin).parent / "random_urdfs" if spec and spec.origin else None
    return folder if folder is not None and folder.is_dir() else None


def draw(count: int, rng: np.random.Generator) -> list[ObjectModel]:
    """`count` different figures as objects of scenes; DataError when pybullet is not installed."""
    chosen: list[ObjectModel] = []
    for number in rng.permutation(COUNT):
        model = _load(f"{number:03d}")
        if model is not None and model.watertight:
            chosen.append(model)
        if len(chosen) == count:
            break
    return chosen


def draw_figure(rng: np.random.Generator) -> TrainingShape:
    """One of the figures at its own size; DataError when pybullet is not installed."""
    model = None
    while model is None:
        model = _load(f"{rng.integers(COUNT):03d}")
    return TrainingShape("random_urdf", (model.mesh,))


def _load(name: str) -> ObjectModel | None:
    """A figure of blocks, None when its file holds nothing usable."""
    folder = figures_folder()
    if folder is None:
        raise DataError("random_urdfs not found: they come with pybullet (pip install pybullet)")
    try:
        model = load_model(folder / name / f"{name}.obj", f"figure_{name}", "builtin", SCALE)
    except DataError:
        return None
    if not np.isfinite(model.mesh.vertices).all():  # one of the shipped files
        return None
    blocks = model.mesh.split(only_watertight=False)
    hulls = [block.convex_hull for block in blocks if len(block.vertices) > 3]
    convex = model.mesh.volume > CONVEX_SHARE * sum(hull.volume for hull in hulls)
    parts = tuple(np.asarray(hull.vertices) for hull in hulls) if convex else ()
    return ObjectModel(model.name, "builtin", model.mesh, model.vertex_colors, parts=parts)
