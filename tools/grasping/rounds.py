"""Where a round of grasping begins: a few objects at rest on a table, and the one camera that sees them.

Knows how objects are arranged, packed or piled, or read from a scene folder; knows nothing of hands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from mapping.errors import DataError
from perception.camera import Camera
from perception.frame_io import load_frame
from sim_scenes.convex_parts import build_all
from sim_scenes.object_source import ObjectSource
from sim_scenes.objects.object_model import ObjectModel, load_model
from sim_scenes.render import random_cameras
from sim_scenes.tabletop import PlacedObject, Tabletop, TabletopConfig
from sim_scenes.truth import load_truth

ARRANGEMENTS = ("packed", "pile")
"""Standing side by side, or dropped on a heap."""
LOOK_AT = np.array([0.0, 0.0, 0.04])
"""What the camera looks at [m]."""


@dataclass(frozen=True)
class RoundConfig:
    """Objects of a round and how they are put down."""

    objects: int = 5
    """Objects a round."""
    narrowest: tuple[float, float] = (0.015, 0.065)
    """An object's smallest width as it stands, from above [m], and the least from any side: what the hand can
    take at all."""
    longest: float = 0.25
    """Largest extent of an object [m]."""
    radius: float = 0.14
    """Packed objects stand within this distance of the middle [m]."""
    gap: float = 0.01
    """Between the boxes of packed objects [m]."""
    pile_radius: float = 0.04
    """Piled objects are dropped within this distance of the middle [m]."""


@dataclass(frozen=True)
class Round:
    """name: unique among the rounds; placed: objects at rest in the world (table top at z = 0)."""

    name: str
    placed: tuple[PlacedObject, ...]
    camera: Camera


def from_scene(folder: Path, ycb_dir: Path | None = None) -> Round:
    """The round that begins as a scene folder shows it, seen by its first camera.

    Raises DataError when it is no scene, or an object is not closed.
    """
    truth = load_truth(folder, ycb_dir)
    placed = [
        PlacedObject(load_model(item.mesh_path, item.name, item.source, item.scale), item.T_world_object)
        for item in truth.objects
    ]
    if not np.allclose(truth.plane, [0, 0, 1, 0], atol=1e-6):
        raise DataError(
            f"{folder}: grasping needs the support at z = 0 of the world, got plane {truth.plane}"
        )
    build_all([item.model for item in placed], progress=False)
    return Round(folder.name, tuple(placed), load_frame(truth.views[0]).camera)


def composed(
    name: str, arrangement: str, source: ObjectSource, rng: np.random.Generator, config: RoundConfig
) -> Round:
    """A round of new objects in an arrangement, from a camera at a random place around them."""
    models: list[ObjectModel] = []
    while len(models) < config.objects:
        drawn = source.draw(4 * config.objects, rng)
        fit = [model for model in drawn if graspable(model, config)]
        if not fit:
            raise DataError(
                f"none of {len(drawn)} objects is of a width that the hand can take: at their narrowest they "
                f"must have {config.narrowest[0]:g} to {config.narrowest[1]:g} m"
            )
        models += fit[: config.objects - len(models)]
    build_all(models, progress=False)
    table_config = TabletopConfig(drop_radius_m=config.pile_radius, upright=0.0)
    with Tabletop(table_config) as table:
        if arrangement == "packed":
            for item in side_by_side(models, rng, config):
                table.place(item)
            table.settle()
        else:
            table.drop(models, rng)
        placed = table.placed()
    (camera,) = random_cameras(1, LOOK_AT, rng)
    return Round(name, tuple(placed), camera)


def graspable(model: ObjectModel, config: RoundConfig) -> bool:
    """Whether the hand can take an object from some side."""
    corners = np.asarray(model.mesh.convex_hull.vertices)
    turns = np.pi * np.arange(36) / 36
    level = np.stack([np.cos(turns), np.sin(turns), np.zeros(36)], axis=1)
    thinnest, across = (np.ptp(corners @ ways.T, axis=0).min() for ways in (_directions(200), level))
    low, high = config.narrowest
    return bool(thinnest >= low and across <= high and model.mesh.extents.max() <= config.longest)


def side_by_side(
    models: Sequence[ObjectModel], rng: np.random.Generator, config: RoundConfig
) -> list[PlacedObject]:
    """Models upright on the table, turned at random, their boxes apart; what finds no room is left out."""
    placed: list[PlacedObject] = []
    boxes: list[tuple[np.ndarray, np.ndarray]] = []
    for model in models:
        for _ in range(60):
            turn = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi)).as_matrix()
            corners = model.mesh.vertices @ turn.T
            angle, radius = rng.uniform(0, 2 * np.pi), config.radius * np.sqrt(rng.random())
            place = radius * np.array([np.cos(angle), np.sin(angle)])
            shift = np.array(
                [*(place - (corners.min(0) + corners.max(0))[:2] / 2), 1e-3 - corners[:, 2].min()]
            )
            low, high = corners.min(0)[:2] + shift[:2], corners.max(0)[:2] + shift[:2]
            if all((low > b + config.gap).any() or (high < a - config.gap).any() for a, b in boxes):
                T = np.eye(4)
                T[:3, :3], T[:3, 3] = turn, shift
                placed.append(PlacedObject(model, T))
                boxes.append((low, high))
                break
    return placed


def _directions(count: int) -> np.ndarray:
    """Unit vectors (count, 3) spread evenly over half a sphere."""
    z = (np.arange(count) + 0.5) / count
    turn = np.pi * (1 + 5**0.5) * np.arange(count)
    return np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], axis=1)
