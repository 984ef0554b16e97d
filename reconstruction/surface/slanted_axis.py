"""The axis of a body of revolution that lies or leans, from points of its surface and their normals.

Knows points only. The line through a point along its normal meets the axis: linear in the axis' Pluecker
coordinates (Pottmann and Randrup 1998), whatever its direction.
"""

from __future__ import annotations

import numpy as np

from mapping.compiled import compiled
from reconstruction.surface.vertical_axis import vertical_axis

FEW = 500
"""About as many points say which way the axis runs."""
ROUNDS = 6
"""Each round trusts less what the last one left far off: handles, labels."""
LEAST = 1e-6
"""Keeps the moment finite where nothing says how far along the axis it is: a cylinder's slides."""


def slanted_axis(points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """A rotation (3, 3) that puts the axis upright, and where (2,) [m] it then meets the plane z = 0.

    None where points (N, 3) [m] with unit normals (N, 3) into the body are not of a body of revolution. The
    end of the axis that more of the normals face away from is up: what is seen of it is its upper side.
    """
    middle = points.mean(0, dtype=np.float64)
    place = points - middle
    size = float(np.sqrt((place**2).sum(1).mean()))
    few = slice(None, None, 1 + len(points) // FEW)
    direction = _direction(place[few] / max(size, 1e-6), normals[few].astype(np.float64))
    if normals.mean(0) @ direction > 0:
        direction = -direction
    turn = _upright(direction)
    axis = vertical_axis((points @ turn.T).astype(np.float32), (normals @ turn.T).astype(np.float32))
    return None if axis is None else (turn, axis)


@compiled
def _direction(place: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """The unit direction (3,) of the axis that most of the lines through places (N, 3) along normals (N, 3)
    come near to."""
    rows = np.empty((len(place), 6))
    for i in range(len(place)):
        for axis in range(3):
            after, last = (axis + 1) % 3, (axis + 2) % 3
            rows[i, axis] = normals[i, after] * place[i, last] - normals[i, last] * place[i, after]
            rows[i, 3 + axis] = -normals[i, axis]
    weight, missed = np.ones(len(rows)), np.empty(len(rows))
    line = np.zeros(6)  # direction and moment
    for _ in range(ROUNDS):
        squares = np.zeros((6, 6))
        for i in range(len(rows)):
            for j in range(6):
                for k in range(6):
                    squares[j, k] += weight[i] * rows[i, j] * rows[i, k]
        moments = squares[3:, 3:] + LEAST * weight.sum() * np.eye(3)
        moment_of = -np.linalg.solve(moments, squares[3:, :3].copy())
        directions = squares[:3, :3] + squares[:3, 3:].copy() @ moment_of
        line[:3] = np.linalg.eigh((directions + directions.T) / 2)[1][:, 0]
        line[3:] = moment_of @ line[:3]
        for i in range(len(rows)):
            far = 0.0
            for j in range(6):
                far += rows[i, j] * line[j]
            missed[i] = abs(far)
        weight = 1 / (1 + (missed / max(np.median(missed), 1e-4)) ** 2)
    return line[:3].copy()


def _upright(direction: np.ndarray) -> np.ndarray:
    """A rotation (3, 3) that turns a unit direction (3,) into z."""
    aside = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    aside /= np.linalg.norm(aside)
    return np.stack([aside, np.cross(direction, aside), direction])
