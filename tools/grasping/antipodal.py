"""The planner that reads surfaces: antipodal contacts, hands around them that touch nothing, the best one.

Knows shapes and a hand; knows nothing of physics or truth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from tools.grasping.clearance import clear, inside
from tools.grasping.contacts import Contacts, across, sampled, through
from tools.grasping.hand import Grasp, HandConfig, hand_pose
from tools.grasping.shapes import Doubt, Shapes


@dataclass(frozen=True)
class AntipodalConfig:
    """What is tried and what a good grasp is."""

    pairs: int = 400
    """Contact pairs tried an object."""
    turns: int = 12
    """Ways of approach tried around the line of a pair."""
    depths: tuple[float, ...] = (0.022, 0.014, 0.007)
    """How far the tips reach beyond the contacts [m]; the first that is clear."""
    spare: float = 0.008
    """The hand opens this much wider than what it takes [m]."""
    steepest_up: float = -0.15
    """Hands come from above: the way in's z is at most this."""
    slip: float = 0.45
    """Largest angle between the line of a pair and a normal [rad]: within friction of the fingers."""
    slip_measured: float = 1.05
    """The same where only measured points are known: seen sides hardly ever face each other."""
    spacing: float = 0.004
    """Surfaces are avoided at points about this far apart [m]."""
    found: int = 40
    """Clear grasps after which no worse ones are tried."""


@dataclass(frozen=True)
class DoubtConfig:
    """What uncertain space costs a grasp."""

    contact: float = 0.5
    """Weight of p(uncertain) at the contacts."""
    way: float = 1.0
    """Weight of the chance that something unseen is in the hand's way: of any of the points there, taken one
    by one."""
    spacing: float = 0.012
    """Points in the hand's way are this far apart [m]."""
    behind: float = 0.05
    """The last part of the way in that is looked at [m]."""
    found: int = 300
    """Clear grasps that are weighed."""


def plan(
    shapes: Shapes,
    hand: HandConfig,
    rng: np.random.Generator,
    doubt: DoubtConfig | None = None,
    config: AntipodalConfig | None = None,
) -> Grasp | None:
    """The best grasp of any object; None when none is clear. doubt: weigh what is uncertain, too."""
    config = config or AntipodalConfig()
    if doubt is not None:
        config = replace(config, found=doubt.found)
    every = [_candidates(label, shapes, hand, rng, config) for label in [*shapes.meshes, *shapes.clouds]]
    found = [grasps for grasps in every if len(grasps)]
    if not found:
        return None
    labels, poses, scores, contacts = (np.concatenate(values) for values in zip(*(g.columns for g in found)))
    order = np.argsort(-scores, kind="stable")
    obstacles = _obstacles(shapes, rng, config)
    kept: list[int] = []
    taken: set[int] = set()
    pair_of = np.unique(contacts.reshape(len(contacts), -1), axis=0, return_inverse=True)[1].reshape(-1)
    for start in range(0, len(order), 256):
        batch = order[start : start + 256]
        for index in batch[clear(poses[batch], obstacles, hand)]:
            # Of one pair the first is the best: the others differ little.
            if doubt is not None or pair_of[index] not in taken:
                taken.add(int(pair_of[index]))
                kept.append(int(index))
        if len(kept) >= config.found:
            break
    if not kept:
        return None
    costs = np.zeros((2, len(kept)))
    if doubt is not None and shapes.doubt is not None:
        costs = _costs(poses[kept], contacts[kept], shapes.doubt, hand, doubt)
    total = scores[kept] - costs.sum(0)
    best = int(total.argmax())
    index = kept[best]
    width = float(np.linalg.norm(contacts[index, 1] - contacts[index, 0]))
    details = {
        "plain": float(scores[index]),
        "contact": float(costs[0, best]),
        "way": float(costs[1, best]),
        "clear": float(len(kept)),
    }
    return Grasp(poses[index], width, float(total[best]), int(labels[index]), details)


@dataclass(frozen=True)
class _Grasps:
    """labels (N,), poses (N, 4, 4), scores (N,), contacts (N, 2, 3)."""

    columns: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]

    def __len__(self) -> int:
        return len(self.columns[0])


def _candidates(
    label: int, shapes: Shapes, hand: HandConfig, rng: np.random.Generator, config: AntipodalConfig
) -> _Grasps:
    """Hands around an object's contact pairs, whatever else stands there."""
    widest = hand.opening - config.spare
    if label in shapes.meshes:
        mesh = shapes.meshes[label]
        pairs = through(mesh, config.pairs, widest, rng)
        middle = mesh.center_mass if mesh.is_watertight and mesh.volume > 0 else mesh.vertices.mean(0)
        limit = config.slip
    else:
        pairs = across(shapes.clouds[label], config.pairs, widest, rng)
        middle, limit = shapes.clouds[label].points.mean(0), config.slip_measured
    good = pairs.slips < limit
    pairs = Contacts(pairs.first[good], pairs.second[good], pairs.slips[good])
    closing, centre = pairs.directions, (pairs.first + pairs.second) / 2
    # At right angles to the line: as far down as can be, and turned about the line from there.
    level = np.cross(closing, [0.0, 0.0, 1.0])
    length = np.linalg.norm(level, axis=1, keepdims=True)
    level = np.where(length > 1e-6, level / np.maximum(length, 1e-6), [1.0, 0.0, 0.0])
    down = np.cross(closing, level)
    down *= -np.sign(down[:, 2:] + 1e-12)
    poses, scores, of_pair = [], [], []
    off = np.linalg.norm((centre - middle)[:, :2], axis=1)
    plain = 1 - pairs.slips / limit * 0.5 - 4 * off
    for turn in 2 * np.pi * np.arange(config.turns) / config.turns:
        approach = Rotation.from_rotvec(turn * closing).apply(down) if len(closing) else down
        usable = approach[:, 2] <= config.steepest_up
        for rank, depth in enumerate(config.depths):
            poses.append(hand_pose(centre + depth * approach, closing, approach)[usable])
            scores.append((plain + 0.2 * -approach[:, 2] - 0.05 * rank)[usable])
            of_pair.append(np.flatnonzero(usable))
    which = np.concatenate(of_pair)
    contacts = np.stack([pairs.first, pairs.second], axis=1)[which]
    labels = np.full(len(which), label)
    return _Grasps((labels, np.concatenate(poses), np.concatenate(scores), contacts))


def _obstacles(shapes: Shapes, rng: np.random.Generator, config: AntipodalConfig) -> np.ndarray:
    """Points (M, 3) [m] of all surfaces."""
    clouds = [cloud.points for cloud in shapes.clouds.values()]
    for mesh in shapes.meshes.values():
        count = int(np.clip(mesh.area / config.spacing**2, 200, 20_000))
        clouds.append(sampled(mesh, count, rng).points)
    return np.concatenate(clouds)


def _costs(
    poses: np.ndarray, contacts: np.ndarray, unsure: Doubt, hand: HandConfig, config: DoubtConfig
) -> np.ndarray:
    """(2, N): what the contacts' uncertainty and what may be in the way cost each pose (N, 4, 4)."""
    _, at_contacts = unsure(contacts.reshape(-1, 3))
    places = inside(hand, config.behind, config.spacing)
    points = places @ poses[:, :3, :3].transpose(0, 2, 1) + poses[:, None, :3, 3]
    occupied, uncertain = unsure(points.reshape(-1, 3))
    risk = np.where(points[..., 2].reshape(-1) > 0, occupied * uncertain, 0).reshape(len(poses), -1)
    in_the_way = 1 - np.prod(1 - risk, axis=1)
    return np.stack([config.contact * at_contacts.reshape(-1, 2).max(1), config.way * in_the_way])
