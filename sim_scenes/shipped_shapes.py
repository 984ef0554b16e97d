"""Meshes that ship with pybullet and bound a volume, scaled to household size."""

from __future__ import annotations

from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from sim_scenes.object_model import ObjectModel, load_model

SHIPPED = {
    "duck": ("duck.obj", 0.10),
    "bunny": ("bunny.obj", 0.12),
    "soccerball": ("soccerball.obj", 0.10),
    "toy_cylinder": ("toys/cylinder.obj", 0.10),
    "toy_prism": ("toys/prism.obj", 0.10),
    "domino": ("domino/domino.obj", 0.05),
}
"""Name -> (file in pybullet_data, largest extent [m] in the mean)."""
SIZE_SPREAD = 0.2
"""Sizes vary by this share up and down."""


@lru_cache(maxsize=1)
def names() -> tuple[str, ...]:
    """Shapes that are there; none when pybullet is not installed."""
    folder = _folder()
    return tuple(name for name, (file, _) in SHIPPED.items() if folder and (folder / file).is_file())


def load(name: str, rng: np.random.Generator) -> ObjectModel:
    """A shipped mesh, scaled about its usual size by `rng`."""
    file, extent = SHIPPED[name]
    folder = _folder()
    assert folder is not None, "names() lists what can be loaded"
    plain = _read(folder / file, name)
    size = extent * rng.uniform(1 - SIZE_SPREAD, 1 + SIZE_SPREAD) / float(plain.mesh.extents.max())
    mesh = plain.mesh.copy()
    mesh.apply_scale(size)
    return ObjectModel(name, "builtin", mesh, plain.vertex_colors, plain.corner_uv, plain.texture)


@lru_cache(maxsize=16)
def _read(path: Path, name: str) -> ObjectModel:
    return load_model(path, name, "builtin")


def _folder() -> Path | None:
    spec = find_spec("pybullet_data")
    return Path(spec.origin).parent if spec and spec.origin else None
