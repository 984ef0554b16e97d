"""Where the mass of something seen at rest must be: over what it stands on.

The inside of an object is guessed, and so is its even density: where the two would let it fall over, the
centre of mass is elsewhere. Knows convex parts and a centre of mass; knows nothing of formats.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from reconstruction.export.apart import Parts, boxes

FOOT = 0.0005
"""What is this near to the support stands on it [m]: feet were made flat."""
TOUCHES = 0.004
"""Parts this near to another object are taken to rest on it [m]."""
WITHIN = 0.5
"""The centre of mass lies within this share of the way from the middle of the ground covered to its rim."""
FARTHEST = 0.3
"""A centre of mass is moved no further than this share of the object's extent: then something else is
wrong."""


def resting_points(label: int, objects: Mapping[int, Parts], support: float, low: float) -> np.ndarray:
    """Places (N, 3) [m] where an object stands on the plane z = `support` or touches another lower than
    z = `low`.

    objects: label -> convex parts in a frame with z up. Places are corners of either's parts.
    """
    own = objects[label]
    corners = _corners(own)
    lower = corners[corners[:, 2] < low]
    found = [corners[corners[:, 2] < support + FOOT]]
    for other, parts in objects.items():
        if other != label:
            theirs = _corners(parts)
            found += [_near(lower, parts), _near(theirs[theirs[:, 2] < low], own)]
    return np.concatenate(found)


def _corners(parts: Parts) -> np.ndarray:
    """(N, 3) [m]"""
    return np.concatenate([np.asarray(part.vertices) for part in parts])


def _near(points: np.ndarray, parts: Parts) -> np.ndarray:
    """Those of points (N, 3) that are in a convex part that was grown by TOUCHES: (M, 3)."""
    # Hundreds of parts, thousands of points, and few of either where two objects touch.
    limits = boxes(parts) + np.array([[-TOUCHES], [TOUCHES]])
    points = points[((points > limits[:, 0].min(0)) & (points < limits[:, 1].max(0))).all(1)]
    if len(points) == 0:
        return points
    reached = (limits[:, 0] < points.max(0)).all(1) & (limits[:, 1] > points.min(0)).all(1)
    inside = np.zeros(len(points), bool)
    for number in np.flatnonzero(reached):
        part = parts[number]
        low, high = part.bounds
        near = np.flatnonzero(~inside & (points > low - TOUCHES).all(1) & (points < high + TOUCHES).all(1))
        if len(near):
            normals = part.face_normals
            heights = np.einsum("ij,ij->i", normals, part.triangles[:, 0])
            inside[near] = (points[near] @ normals.T <= heights + TOUCHES).all(1)
    return points[inside]


def extent_of(parts: Parts) -> float:
    """An object's diameter from above [m]."""
    return float(np.linalg.norm(np.ptp(_corners(parts)[:, :2], axis=0)))


def balanced(centre: np.ndarray, resting: np.ndarray, extent: float) -> np.ndarray:
    """The centre of mass (3,) [m], moved level to where an object that rests on points (N, 3) does not fall.

    extent: the object's diameter from above [m]. The centre stays where it is when it is well within their
    ground already, when they cover none, or when it would have to be moved too far.
    """
    rim = _rim(resting)
    if rim is None:
        return centre
    moved = _nearest_within(centre[:2], rim)
    if np.linalg.norm(moved - centre[:2]) > FARTHEST * extent:
        return centre
    return np.array([*moved, centre[2]])


def well_within(centre: np.ndarray, resting: np.ndarray) -> bool:
    """Whether a centre of mass (3,) is well within the ground that points (N, 3) cover."""
    rim = _rim(resting)
    return rim is not None and bool((_nearest_within(centre[:2], rim) == centre[:2]).all())


def _rim(resting: np.ndarray) -> np.ndarray | None:
    """Corners (N, 2), counterclockwise, of the ground in which a centre of mass is at ease; None for none."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(resting[:, :2])
    except (QhullError, ValueError):
        return None
    rim = resting[hull.vertices, :2]
    middle = _centroid(rim)
    return middle + WITHIN * (rim - middle)


def _centroid(rim: np.ndarray) -> np.ndarray:
    """Centre of area (2,) of a convex polygon (N, 2)."""
    origin = rim[0]
    a, b = rim[1:-1] - origin, rim[2:] - origin
    areas = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return origin + ((a + b) * areas[:, None]).sum(0) / (3 * areas.sum())


def _nearest_within(point: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """The point (2,) of a convex polygon (N, 2), counterclockwise, that is nearest to a point."""
    ways = np.roll(rim, -1, axis=0) - rim
    offsets = point - rim
    if (ways[:, 0] * offsets[:, 1] - ways[:, 1] * offsets[:, 0] >= 0).all():
        return point
    share = np.clip((offsets * ways).sum(1) / np.maximum((ways**2).sum(1), 1e-18), 0, 1)
    nearest = rim + share[:, None] * ways
    return nearest[np.linalg.norm(nearest - point, axis=1).argmin()]
