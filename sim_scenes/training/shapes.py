"""Random everyday shapes that the occlusion prior learns from: unions of watertight parts, metres.

Nothing here is measured from a real object or a scan. Every family is a function of one random generator.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import trimesh

from sim_scenes.training import tools, toys, vessels

Family = Callable[[np.random.Generator], list[trimesh.Trimesh]]


@dataclass(frozen=True)
class TrainingShape:
    """A shape in its own frame, z up as it usually stands: inside means inside any of its parts."""

    family: str
    parts: tuple[trimesh.Trimesh, ...]


SCALE = 0.3
"""Sizes vary by up to this in the logarithm."""
STRETCH = 0.15
"""Each axis varies by up to this in the logarithm, on top."""


FAMILIES: dict[str, Family] = {
    "block": toys.block,
    "flat_box": toys.flat_box,
    "packet": toys.packet,
    "can": vessels.can,
    "cone": vessels.cone,
    "bottle": vessels.bottle,
    "spray_bottle": vessels.spray_bottle,
    "ball": toys.ball,
    "ellipsoid": toys.ellipsoid,
    "fruit": toys.fruit,
    "cup": vessels.cup,
    "mug": vessels.mug,
    "pitcher": vessels.pitcher,
    "bowl": vessels.bowl,
    "dish": vessels.dish,
    "pan": vessels.pan,
    "pot": vessels.pot,
    "basket": vessels.basket,
    "lid": vessels.lid,
    "banana": toys.banana,
    "rod": tools.rod,
    "cutlery": tools.cutlery,
    "scissors": tools.scissors,
    "wrench": tools.wrench,
    "clamp": tools.clamp,
    "angle_block": toys.angle_block,
    "bricks": toys.bricks,
    "toy": toys.toy,
    "plane": toys.plane,
    "drill": tools.drill,
    "padlock": tools.padlock,
    "chain": tools.chain,
    "peg_board": toys.peg_board,
    "tray": toys.tray,
    "hammer": tools.hammer,
    "star": toys.star,
    "goblet": vessels.goblet,
}
HELD_OUT_FAMILIES = ("hammer", "star", "goblet")
"""Never trained on: they tell how the prior does on shapes of another kind."""
TRAINING_FAMILIES = tuple(name for name in FAMILIES if name not in HELD_OUT_FAMILIES)


WEIGHTS = {"block": 3.0, "packet": 2.0, "can": 2.0, "bottle": 2.0, "cup": 3.0, "mug": 4.0, "bowl": 4.0}
WEIGHTS |= {"dish": 3.0, "pan": 2.0, "pot": 3.0, "basket": 3.0, "pitcher": 2.0}
"""How often a family is drawn; one for the others. Boxes, cans and vessels are what stands on most tables,
and what is hollow is the hardest to guess."""


HOLLOW_FAMILIES = ("cup", "mug", "pitcher", "bowl", "dish", "pan", "pot", "basket", "lid", "tray")
"""Families of thin walls."""


def draw_shape(rng: np.random.Generator, families: tuple[str, ...] = TRAINING_FAMILIES) -> TrainingShape:
    """A random shape of a random family."""
    weights = np.array([WEIGHTS.get(family, 1.0) for family in families])
    name = families[rng.choice(len(families), p=weights / weights.sum())]
    parts = FAMILIES[name](rng)
    scale = np.exp(rng.uniform(-SCALE, SCALE) + rng.uniform(-STRETCH, STRETCH, 3))
    for part in parts:
        part.vertices = part.vertices * scale
    return TrainingShape(name, tuple(parts))
