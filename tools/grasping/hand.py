"""A parallel-jaw hand of boxes, and the grasp that places it. Knows geometry only.

Frame of the hand: the origin lies midway between the finger tips, z leads forward (the way of approach), the
fingers close along y.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import trimesh


@dataclass(frozen=True)
class HandConfig:
    """Sizes of the hand and how it moves."""

    opening: float = 0.08
    """Largest distance between the fingers [m]."""
    finger: tuple[float, float, float] = (0.018, 0.010, 0.050)
    """A finger along x, y, z [m]."""
    palm: tuple[float, float, float] = (0.050, 0.120, 0.050)
    """The palm behind the fingers along x, y, z [m]."""
    retreat: float = 0.10
    """The hand comes in straight from this far behind the grasp [m]."""
    force: float = 20.0
    """Of each finger [N]."""
    friction: float = 1.0
    """Of the fingers; pybullet multiplies it with the object's."""
    speed: float = 0.20
    """Of the hand [m/s]."""


@dataclass(frozen=True)
class Grasp:
    """A hand's pose T_world_hand (4, 4) [m]. width: between the contacts [m]; score: higher is better; label:
    the object it is meant for, 0 if the planner does not know objects."""

    T_world_hand: np.ndarray
    width: float
    score: float
    label: int = 0
    details: dict[str, float] = field(default_factory=dict)


def hand_boxes(config: HandConfig, opening: float, behind: float = 0.0) -> np.ndarray:
    """(3, 2, 3) [m]: corners low, high of both fingers and the palm in the hand's frame.

    behind: each reaches this much further back, so that it holds the way in as well.
    """
    x, y, z = config.finger
    px, py, pz = config.palm
    middle = opening / 2 + y / 2
    fingers = [[[-x / 2, s * middle - y / 2, -z - behind], [x / 2, s * middle + y / 2, 0.0]] for s in (-1, 1)]
    palm = [[-px / 2, -py / 2, -z - pz - behind], [px / 2, py / 2, -z]]
    return np.array([*fingers, palm])


def hand_mesh(grasp: Grasp, config: HandConfig, opening: float | None = None) -> trimesh.Trimesh:
    """The hand as a mesh [m, world frame], for pictures."""
    boxes = [
        trimesh.creation.box(bounds=box)
        for box in hand_boxes(config, config.opening if opening is None else opening)
    ]
    whole = trimesh.util.concatenate(boxes)
    assert isinstance(whole, trimesh.Trimesh)
    whole.apply_transform(grasp.T_world_hand)
    return whole


def hand_pose(centre: np.ndarray, closing: np.ndarray, approach: np.ndarray) -> np.ndarray:
    """T_world_hand (..., 4, 4) of hands whose tips' middle is `centre` (..., 3) [m], which close along unit
    vectors `closing` and come along unit vectors `approach` at right angles to them."""
    T = np.zeros((*centre.shape[:-1], 4, 4))
    T[..., :3, 0] = np.cross(closing, approach)
    T[..., :3, 1], T[..., :3, 2], T[..., :3, 3] = closing, approach, centre
    T[..., 3, 3] = 1
    return T
