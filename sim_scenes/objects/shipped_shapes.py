"""Meshes that ship with pybullet and bound a volume, scaled to household size."""

from __future__ import annotations

from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path

from sim_scenes.objects.object_model import ObjectModel, load_model

SHIPPED = {
    "duck": ("duck.obj", 0.10),
    "bunny": ("bunny.obj", 0.12),
    "soccerball": ("soccerball.obj", 0.10),
    "toy_cylinder": ("toys/cylinder.obj", 0.10),
    "toy_prism": ("toys/prism.obj", 0.10),
    "domino": ("domino/domino.obj", 0.05),
}
"""Name -> (file in pybullet_data, largest extent [m])."""


@lru_cache(maxsize=1)
def names() -> tuple[str, ...]:
    """Shapes that are there; none when pybullet is not installed."""
    folder = _folder()
    return tuple(name for name, (file, _) in SHIPPED.items() if folder and (folder / file).is_file())


@lru_cache(maxsize=16)
def load(name: str) -> ObjectModel:
    """A shipped mesh at household size; always the same, so that its collision shape is cached."""
    file, extent = SHIPPED[name]
    folder = _folder()
    assert folder is not None, "names() lists what can be loaded"
    plain = load_model(folder / file, name, "builtin")
    mesh = plain.mesh.copy()
    mesh.apply_scale(extent / float(plain.mesh.extents.max()))
    return ObjectModel(name, "builtin", mesh, plain.vertex_colors, plain.corner_uv, plain.texture)


def _folder() -> Path | None:
    spec = find_spec("pybullet_data")
    return Path(spec.origin).parent if spec and spec.origin else None
