"""Procedural household objects, with random dimensions and colours, as watertight meshes; z up, metres.

`make(family, rng)` draws one of a family; `families()` names them, so that a training set can use
some and hold out others. Shapes that ship with pybullet are families of their own (`shipped_shapes`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mapping.errors import ConfigError
from sim_scenes.objects import shipped_shapes, tools, toys, vessels
from sim_scenes.objects.object_model import ObjectModel
from sim_scenes.objects.paint import Shape

PROCEDURAL: dict[str, Callable[[np.random.Generator], Shape]] = {
    "box": toys.box,
    "can": vessels.can,
    "bottle": vessels.bottle,
    "bowl": vessels.bowl,
    "cup": vessels.cup,
    "mug": vessels.mug,
    "plate": vessels.plate,
    "ball": toys.ball,
    "fruit": toys.fruit,
    "banana": toys.banana,
    "screwdriver": tools.screwdriver,
    "hammer": tools.hammer,
    "wrench": tools.wrench,
    "spoon": tools.spoon,
    "spatula": tools.spatula,
    "blocks": toys.blocks,
    "ring": toys.ring,
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
