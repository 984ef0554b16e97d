"""Which way a cuboid's faces look, from points of its surface and their normals. Knows points and normals
only."""

from __future__ import annotations

import cv2
import numpy as np

from mapping.compiled import compiled

ALONG = 0.95
"""Normals within the angle of this cosine belong to a face (18 degrees)."""
ACROSS = 0.3
"""Normals within the angle of this sine are at right angles to a direction (17 degrees)."""
CANDIDATES = 40
"""About so many normals are tried as the direction of a face."""
ROUNDS = 3
"""Each round knows a face's direction better, and with it which points are the face's."""
FEWEST = 20
"""Fewer points say nothing of a direction or an end."""
NARROW = 0.003
"""Points that spread less than this [m] say nothing of a plane; their normals do."""
FACE_SHARE = 0.03
"""A face holds at least this share of the points."""
FACES_SHARE = 0.55
"""At least this share of the normals lies along the faces': where two faces meet they are in between, and a
sensor's noise bends them."""
FLAT, OFF = 0.0015, 2.0
"""Points so many times farther than half of them are from a plane, or than half of this [m], are off it."""


def face_directions(points: np.ndarray, normals: np.ndarray) -> np.ndarray | None:
    """The directions (3, 3), rows of unit length at right angles, that the faces of a cuboid have.

    None where unit normals (N, 3) of points (N, 3) float32 [m] do not lie along three such.
    """
    first = _direction(normals, points, np.zeros(3))
    if not first.any():
        return None
    across = np.abs(normals @ first) < ACROSS
    if across.mean() >= FACE_SHARE:
        level = normals[across] - np.outer(normals[across] @ first, first)
        level /= np.linalg.norm(level, axis=1)[:, None]
        second = _direction(level.astype(np.float32), points[across], first)
        if not second.any():
            return None
    else:
        second = _edge(points[np.abs(normals @ first) > ALONG], first)
    axes = np.stack([first, second, np.cross(first, second)])
    return axes if (np.abs(normals @ axes.T).max(1) > ALONG).mean() >= FACES_SHARE else None


@compiled
def _direction(normals: np.ndarray, points: np.ndarray, across: np.ndarray) -> np.ndarray:
    """The direction (3,) that most normals (N, 3) lie along, at right angles to `across` (3,) unless that is
    zero; from the plane of their points (N, 3), for normals are bent near edges. Zero where too few do."""
    free = not across.any()
    best = _commonest(normals)
    for _ in range(ROUNDS):
        own = _along(normals, best)
        if len(own) < FEWEST:
            return np.zeros(3)
        found, middle, off = np.zeros(3), np.empty(3), np.empty(len(own))
        for axis in range(3):
            found[axis] = normals[own, axis].mean()
            middle[axis] = np.median(points[own, axis])
        for i in range(len(own)):
            off[i] = abs(_dot(points[own[i]] - middle, best))
        limit = OFF * max(np.median(off), FLAT / 2)
        if not free:
            found -= _dot(found, across) * across
        found /= np.sqrt(_dot(found, found))
        plane, spread = _plane(points[own[off <= limit]] - middle, across)
        if spread > NARROW**2 and abs(_dot(plane, found)) > ALONG:
            found = plane * np.sign(_dot(plane, found))
        best = found
    return best


@compiled
def _plane(face: np.ndarray, across: np.ndarray) -> tuple[np.ndarray, float]:
    """The normal (3,), at right angles to `across` unless that is zero, of the plane of points (N, 3) about
    the origin; and how they spread along it in the direction that they spread less in [m^2]."""
    squares = np.zeros((3, 3))
    for i in range(len(face)):
        point = face[i] - _dot(face[i], across) * across
        for j in range(3):
            for k in range(3):
                squares[j, k] += point[j] * point[k]
    spread, directions = np.linalg.eigh(squares / max(len(face), 1))
    # The direction of least spread is the plane's; that of none at all is `across`.
    least = 1 if across.any() else 0
    return directions[:, least].copy(), spread[least + 1]


@compiled
def _commonest(normals: np.ndarray) -> np.ndarray:
    """Of some of the normals (N, 3) the one (3,) that most lie along, whichever way."""
    best, most = np.zeros(3), -1
    for i in range(0, len(normals), 1 + len(normals) // CANDIDATES):
        count = 0
        for j in range(len(normals)):
            count += abs(_dot(normals[j], normals[i])) > ALONG
        if count > most:
            best, most = normals[i].astype(np.float64), count
    return best


@compiled
def _along(normals: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Numbers (M,) of the normals (N, 3) that lie along a direction (3,)."""
    own = np.zeros(len(normals), np.bool_)
    for i in range(len(normals)):
        own[i] = _dot(normals[i], direction) > ALONG
    return np.flatnonzero(own)


@compiled
def _dot(a: np.ndarray, b: np.ndarray) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _edge(face: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """The direction (3,) of a side of the smallest rectangle around points (N, 3) of one face."""
    aside = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    aside /= np.linalg.norm(aside)
    plane = np.stack([aside, np.cross(normal, aside)])
    _, _, degrees = cv2.minAreaRect((face @ plane.T).astype(np.float32))
    turn = np.deg2rad(degrees)
    return np.cos(turn) * plane[0] + np.sin(turn) * plane[1]
