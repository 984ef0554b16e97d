"""Which poses of the hand touch nothing, on the way in as well.

Knows points of surfaces and a table at z = 0.
"""

from __future__ import annotations

import numpy as np

from tools.grasping.hand import HandConfig, hand_boxes

MARGIN = 0.002
"""The hand keeps this far from what is known [m]."""
TABLE = 0.003
"""And this far above the table [m]."""
BATCH = 32
"""Poses that are compared with the points at a time."""


def clear(T_world_hand: np.ndarray, obstacles: np.ndarray, hand: HandConfig) -> np.ndarray:
    """(N,) bool: which of the poses (N, 4, 4) of the open hand, with the straight way to them, hold none of
    the obstacle points (M, 3) [m] and stay above the table."""
    boxes = hand_boxes(hand, hand.opening, hand.retreat) + np.array([[-MARGIN], [MARGIN]])
    free = lowest(T_world_hand, hand) > TABLE
    low, high = boxes[:, 0].min(0), boxes[:, 1].max(0)
    reach = float(np.linalg.norm(np.maximum(np.abs(low), np.abs(high))))
    points = obstacles.astype(np.float32)
    wanted = np.flatnonzero(free)
    for start in range(0, len(wanted), BATCH):
        chosen = wanted[start : start + BATCH]
        T = T_world_hand[chosen].astype(np.float32)
        centre = T[:, :3, 3]
        near = points[((points > centre.min(0) - reach) & (points < centre.max(0) + reach)).all(1)]
        x, y, z = (near @ T[:, :3, i].T - (centre * T[:, :3, i]).sum(1) for i in range(3))  # (M, N) each
        hit = np.zeros(x.shape, bool)
        for a, b in boxes:
            hit |= (x > a[0]) & (x < b[0]) & (y > a[1]) & (y < b[1]) & (z > a[2]) & (z < b[2])
        free[chosen[hit.any(0)]] = False
    return free


def lowest(T_world_hand: np.ndarray, hand: HandConfig) -> np.ndarray:
    """(N,) height [m] of the lowest corner of the open hand at poses (N, 4, 4)."""
    bits = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(-1, 3)
    corners = np.concatenate([box[bits, np.arange(3)] for box in hand_boxes(hand, hand.opening)])
    return (T_world_hand[:, 2, :3] @ corners.T).min(1) + T_world_hand[:, 2, 3]


def inside(hand: HandConfig, behind: float, spacing: float) -> np.ndarray:
    """Points (P, 3) [m, hand frame] on a lattice through the open hand and, for the last `behind` [m], its
    way in."""
    found = []
    for low, high in hand_boxes(hand, hand.opening, behind):
        counts = np.maximum(np.round((high - low) / spacing).astype(int), 2)
        axes = [np.linspace(a, b, n) for a, b, n in zip(low, high, counts)]
        found.append(np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3))
    return np.concatenate(found)
