"""Procedural household objects, with random dimensions and colours, as watertight meshes; z up, metres.

`make(family, rng)` draws one of a family; `families()` names them, so that a training set can use
some and hold out others. Shapes that ship with pybullet are families of their own (`shipped_shapes`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mapping.errors import ConfigError
from sim_scenes import builtin_tools, builtin_toys, builtin_vessels, shipped_shapes
from sim_scenes.object_model import ObjectModel
from sim_scenes.paint import Shape

PROCEDURAL: dict[str, Callable[[np.random.Generator], Shape]] = {
    "box": builtin_toys.box,
    "can": builtin_vessels.can,
    "bottle": builtin_vessels.bottle,
    "bowl": builtin_vessels.bowl,
    "cup": builtin_vessels.cup,
    "mug": builtin_vessels.mug,
    "plate": builtin_vessels.plate,
    "ball": builtin_toys.ball,
    "fruit": builtin_toys.fruit,
    "banana": builtin_toys.banana,
    "screwdriver": builtin_tools.screwdriver,
    "hammer": builtin_tools.hammer,
    "wrench": builtin_tools.wrench,
    "spoon": builtin_tools.spoon,
    "spatula": builtin_tools.spatula,
    "blocks": builtin_toys.blocks,
    "ring": builtin_toys.ring,
}
"""Family name -> maker."""


def families() -> list[str]:
    """Names of all families, procedural first, then the shapes that ship with pybullet."""
    return [*PROCEDURAL, *shipped_shapes.names()]


def make(family: str, rng: np.random.Generator) -> ObjectModel:
    """One object of a family with random dimensions and colours (shipped shapes have fixed ones).

    Raises ConfigError for an unknown family.
    """
    if family in PROCEDURAL:
        mesh, colors, parts = PROCEDURAL[family](rng)
        tint = np.clip(colors * 255, 0, 255).astype(np.uint8)
        return ObjectModel(family, "builtin", mesh, vertex_colors=tint, parts=tuple(parts))
    if family in shipped_shapes.names():
        return shipped_shapes.load(family)
    raise ConfigError(f"family: {family!r} is unknown; valid: {', '.join(families())}")


def draw(count: int, rng: np.random.Generator) -> list[ObjectModel]:
    """Objects of different families (of the same again only when there are more objects than families)."""
    names = families()
    chosen = np.concatenate([rng.permutation(len(names)) for _ in range(-(-count // len(names)))])
    return [make(names[index], rng) for index in chosen[:count]]
