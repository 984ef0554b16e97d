"""Random everyday shapes that the occlusion prior learns from: unions of watertight parts, metres.

Nothing here is measured from a real object or a scan. Every family is a function of one random generator.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import trimesh

from sim_scenes import training_tools, training_toys, training_vessels

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
    "block": training_toys.block,
    "flat_box": training_toys.flat_box,
    "packet": training_toys.packet,
    "can": training_vessels.can,
    "cone": training_vessels.cone,
    "bottle": training_vessels.bottle,
    "spray_bottle": training_vessels.spray_bottle,
    "ball": training_toys.ball,
    "ellipsoid": training_toys.ellipsoid,
    "fruit": training_toys.fruit,
    "cup": training_vessels.cup,
    "mug": training_vessels.mug,
    "pitcher": training_vessels.pitcher,
    "bowl": training_vessels.bowl,
    "dish": training_vessels.dish,
    "pan": training_vessels.pan,
    "lid": training_vessels.lid,
    "banana": training_toys.banana,
    "rod": training_tools.rod,
    "cutlery": training_tools.cutlery,
    "scissors": training_tools.scissors,
    "wrench": training_tools.wrench,
    "clamp": training_tools.clamp,
    "angle_block": training_toys.angle_block,
    "bricks": training_toys.bricks,
    "toy": training_toys.toy,
    "plane": training_toys.plane,
    "drill": training_tools.drill,
    "padlock": training_tools.padlock,
    "chain": training_tools.chain,
    "peg_board": training_toys.peg_board,
    "tray": training_toys.tray,
    "hammer": training_tools.hammer,
    "star": training_toys.star,
    "goblet": training_vessels.goblet,
}
HELD_OUT_FAMILIES = ("hammer", "star", "goblet")
"""Never trained on: they tell how the prior does on shapes of another kind."""
TRAINING_FAMILIES = tuple(name for name in FAMILIES if name not in HELD_OUT_FAMILIES)


WEIGHTS = {"block": 3.0, "packet": 2.0, "can": 2.0, "bottle": 2.0, "cup": 3.0, "bowl": 2.0, "dish": 2.0}
"""How often a family is drawn; one for the others. Boxes, cans and vessels are what stands on most tables."""


def draw_shape(rng: np.random.Generator, families: tuple[str, ...] = TRAINING_FAMILIES) -> TrainingShape:
    """A random shape of a random family."""
    weights = np.array([WEIGHTS.get(family, 1.0) for family in families])
    name = families[rng.choice(len(families), p=weights / weights.sum())]
    parts = FAMILIES[name](rng)
    scale = np.exp(rng.uniform(-SCALE, SCALE) + rng.uniform(-STRETCH, STRETCH, 3))
    for part in parts:
        part.vertices = part.vertices * scale
    return TrainingShape(name, tuple(parts))
