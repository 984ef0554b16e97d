"""What is held out, and which labels are wrong, when semantic maps are measured.

Knows scenes of labelled points; must not know methods.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from mapping.errors import ConfigError
from perception.labelled_cloud import LabelledCloud
from tools.reproduce.semantic.scenes import Scene

PROTOCOLS = (
    *("points", "blocks", "next", "last", "merged"),
    *("labels10", "labels20", "labels30", "labels40"),
    *("patches10", "patches20", "patches30", "patches40"),
)
"""(a) a tenth of the points held out; (b) whole blocks; (c) the next scans, or the last of them alone, asked
of the map of the first, and the last one asked of one map of all scans before it; (d) so many per cent of
the labels wrong, at random or patch by patch."""
HELD_OUT = 0.1
BLOCK = 2.0
"""Side of the blocks that are held out whole [m]."""
PATCH = 1.0
"""Side of the patches in which all points of a class get the same wrong label [m]."""
NEAR = 0.5
"""A place with a return within this distance is observed [m]."""
BEAM = 0.01
"""So is one with a beam within this angle that went on beyond it [rad]."""
MOST_TEST = 100_000
"""At most so many points of the next scans are asked for."""
MOST_UNOBSERVED = 10_000


@dataclass(frozen=True)
class Case:
    """Training points (N, 3) [m] and labels (N,), test points and true labels, unobserved places (M, 3)."""

    X: np.ndarray
    y: np.ndarray
    X_test: np.ndarray
    y_test: np.ndarray
    unobserved: np.ndarray


def has_protocol(scene: Scene, protocol: str) -> bool:
    """Whether a scene can be measured so: the next scans must be there."""
    return len(scene.following) >= {"next": 1, "last": 2, "merged": 2}.get(protocol, 0)


def make_case(scene: Scene, protocol: str, rng: np.random.Generator) -> Case:
    """Split a scene by a protocol. Raises ConfigError for an unknown one."""
    if protocol not in PROTOCOLS:
        raise ConfigError(f"protocol {protocol!r}: choose from {', '.join(PROTOCOLS)}")
    if protocol == "merged":
        scene = replace(scene, first=scene.first + scene.following[:-1])
    X, y = scene.X, scene.y
    unobserved = unobserved_places(scene.first, MOST_UNOBSERVED, rng)
    if protocol in ("next", "last", "merged"):
        asked = scene.following if protocol == "next" else scene.following[-1:]
        X_test = np.concatenate([cloud.points for cloud in asked])
        y_test = np.concatenate([cloud.labels for cloud in asked])
        some = rng.permutation(len(X_test))[:MOST_TEST]
        return Case(X, y, X_test[some], y_test[some], unobserved)
    held = held_out_blocks(X, rng) if protocol == "blocks" else rng.random(len(X)) < HELD_OUT
    wrong = y[~held]
    if protocol.startswith("labels"):
        wrong = mislabel(wrong, np.arange(len(wrong)), int(protocol[6:]) / 100, rng)
    elif protocol.startswith("patches"):
        cells = np.column_stack([np.floor(X[~held] / PATCH), wrong])
        patch = np.unique(cells, axis=0, return_inverse=True)[1].reshape(-1)
        wrong = mislabel(wrong, patch, int(protocol[7:]) / 100, rng)
    return Case(X[~held], wrong, X[held], y[held], unobserved)


def held_out_blocks(X: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(N,) bool: whether a point's block is among the tenth that is held out."""
    blocks, block = np.unique(np.floor(X / BLOCK).astype(int), axis=0, return_inverse=True)
    return (rng.random(len(blocks)) < HELD_OUT)[block.reshape(-1)]


def mislabel(y: np.ndarray, group: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """Labels (N,) of which about a `share` of the groups (N,) got another class that is present."""
    present = np.unique(y)
    if len(present) < 2:
        return y
    count = int(group.max()) + 1
    bad = rng.random(count) < share
    shift = rng.integers(1, len(present), count)
    moved = present[(np.searchsorted(present, y) + shift[group]) % len(present)]
    return np.where(bad[group], moved, y)


def unobserved_places(clouds: list[LabelledCloud], count: int, rng: np.random.Generator) -> np.ndarray:
    """Up to `count` places (M, 3) [m] in the clouds' box with no return near and no beam through."""
    X = np.concatenate([cloud.points for cloud in clouds])
    low, high = np.quantile(X, 0.01, axis=0), np.quantile(X, 0.99, axis=0)
    places = rng.uniform(low, high, (4 * count, 3))
    seen = cKDTree(X).query(places, distance_upper_bound=NEAR)[0] < NEAR
    for cloud in clouds:
        if cloud.origin is not None:
            seen |= _beam_through(cloud, cloud.origin, places)
    return places[~seen][:count]


def _beam_through(cloud: LabelledCloud, origin: np.ndarray, places: np.ndarray) -> np.ndarray:
    rays, asked = cloud.points - origin, places - origin
    length, distance = np.linalg.norm(rays, axis=1), np.linalg.norm(asked, axis=1)
    near = cKDTree(rays / np.maximum(length, 1e-9)[:, None])
    angle, beam = near.query(asked / np.maximum(distance, 1e-9)[:, None], k=4, distance_upper_bound=BEAM)
    reached = np.append(length, 0.0)[beam] > distance[:, None]
    return (np.isfinite(angle) & reached).any(axis=1)
