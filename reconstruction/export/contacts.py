"""Where one object can push another: places where their convex parts are near, and in which direction.

Knows convex parts in a frame with z up, whose support is z = 0; knows nothing of masses or formats.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from reconstruction.export.apart import Parts, boxes

FOOT = 0.0005
"""What is this near to the support stands on it [m]: feet were made flat."""
TOUCHES = 0.004
"""Parts this near to another object are taken to touch it [m]."""
BELOW = -0.3
"""A push whose direction points further down than this comes from something that lies on top: it holds
nothing."""
CARRIES = 0.25
"""An upward share of a push from which on it bears weight, and so has friction."""
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Contacts:
    """places: (N, 3) [m]; pushes: (N, 3) unit vectors, the direction in which an object is pushed there."""

    places: np.ndarray
    pushes: np.ndarray

    @staticmethod
    def upwards(places: np.ndarray) -> Contacts:
        """On level ground."""
        return Contacts(places, np.broadcast_to(UP, places.shape))

    @property
    def carries(self) -> np.ndarray:
        """(N,) bool: which bear weight."""
        return self.pushes[:, 2] > CARRIES

    def on_the_support(self) -> Contacts:
        """Those with the support alone."""
        kept = self.places[:, 2] < FOOT
        return Contacts(self.places[kept], self.pushes[kept])

    def joined(self, other: Contacts) -> Contacts:
        """Both."""
        return Contacts(
            np.concatenate([self.places, other.places]), np.concatenate([self.pushes, other.pushes])
        )


def contacts_of(label: int, objects: Mapping[int, Parts]) -> Contacts:
    """Where an object stands on the support or touches others: corners of either's parts.

    objects: label -> convex parts.
    """
    own = objects[label]
    corners = corners_of(own)
    found = Contacts.upwards(corners[corners[:, 2] < FOOT])
    for other, parts in objects.items():
        if other == label:
            continue
        places, outwards = _near(corners, parts)
        found = found.joined(Contacts(places, outwards))
        places, outwards = _near(corners_of(parts), own)
        found = found.joined(Contacts(places, -outwards))
    holds = found.pushes[:, 2] > BELOW
    return Contacts(found.places[holds], found.pushes[holds])


def corners_of(parts: Parts) -> np.ndarray:
    """(N, 3) [m]"""
    return np.concatenate([part.vertices for part in parts])


def _near(points: np.ndarray, parts: Parts) -> tuple[np.ndarray, np.ndarray]:
    """Those of points (N, 3) that are in a convex part that was grown by TOUCHES: (M, 3), and the normal
    (M, 3) of the face that they are nearest to."""
    # Hundreds of parts, thousands of points, and few of either where two objects touch.
    limits = boxes(parts) + np.array([[-TOUCHES], [TOUCHES]])
    points = points[((points > limits[:, 0].min(0)) & (points < limits[:, 1].max(0))).all(1)]
    away, normals = np.full(len(points), TOUCHES), np.zeros_like(points)
    if len(points) == 0:
        return points, normals
    reached = (limits[:, 0] < points.max(0)).all(1) & (limits[:, 1] > points.min(0)).all(1)
    for number in np.flatnonzero(reached):
        low, high = limits[number]
        near = np.flatnonzero(((points > low) & (points < high)).all(1))
        if len(near) == 0:
            continue
        faces = parts[number].face_normals
        outside = points[near] @ faces.T - parts[number].heights
        face = outside.argmax(1)
        depth = outside[np.arange(len(near)), face]
        # Of parts side by side the one that the point is nearest to: the others' faces may be within it.
        better = depth < away[near]
        away[near[better]], normals[near[better]] = depth[better], faces[face[better]]
    found = np.einsum("ij,ij->i", normals, normals) > 0.5
    return points[found], normals[found]
