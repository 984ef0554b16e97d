"""The plane that objects stand on: candidates by RANSAC, the choice by what rests on them, least squares.

Walls, floors and the tops of boxes are planes too, and often larger than the visible table. So the
largest plane is not taken, but the one close below the objects that they all stand in front of.
"""

from __future__ import annotations

import numpy as np

from perception.config import PerceptionConfig
from perception.grouping import group_by_label
from perception.observation import SupportPlane
from perception.quantiles import column_quantiles, quantiles

REST_LENGTH = 0.05
"""How fast a plane loses credit with the gap between it and the objects' lowest points [m]."""
STEEP = 0.9
"""Cosine between the line of sight and the plane's normal from which on objects hide their own feet."""
HIDDEN_FOOT = 8
"""Seen from straight above, `REST_LENGTH` is larger by this many times."""
FIT_POINTS = 12_000
"""Points used by the least-squares refinement and the inlier ratio."""
MINIMUM_SPREAD = 0.015
"""Standard deviation of the inliers along the plane's narrow direction below which it is a sliver [m]."""
FOOTPRINT = 2.0
"""The seen part of a plane, in standard deviations of its points around their centre."""
CLUTTER_SHARE = 0.1
"""Share of all points standing on a plane that makes it a full table."""
LEAST_PEAK = 0.65
"""Points within the threshold over those within twice of it: 1 on a plane, 0.5 on a wall cut across."""
GREEDY = 0.4
"""Masks that leave next to nothing of the table cover more of the image than this; smaller ones are of things
on a table that gave no depth, such as a pane of glass, and no side of a thing is taken for it."""
HOVERING = 0.05
"""A plane on which the objects rest no better than this, if hidden feet are not allowed for, may be a wall
seen head-on: it looks like a table seen from straight above."""
CONTACT = 0.3
"""A plane across it, on which they rest as well as this, is the table then ..."""
ACROSS = 0.3
"""... if the cosine between the two normals is below this ..."""
UPRIGHT = 0.9
"""... and it faces the image's top."""
MINIMUM_CREDIT = 0.02
"""Least credit (share of points x how well the objects rest on it) of a convincing plane."""


def find_support_plane(
    points: np.ndarray, labels: np.ndarray | None, config: PerceptionConfig, rng: np.random.Generator
) -> SupportPlane | None:
    """The support plane in the camera frame, or None when no plane is convincing.

    points: (H, W, 3) [m], NaN where missing. labels: (H, W) instance labels or None.
    """
    flat = points.reshape(-1, 3)
    measured = np.isfinite(flat[:, 2])
    if labels is None:
        background, objects = np.flatnonzero(measured), np.empty(0, np.int64)
    else:
        labelled = labels.reshape(-1) > 0
        background, objects = np.flatnonzero(measured & ~labelled), np.flatnonzero(measured & labelled)
        if background.size < config.plane_points // 4 and labelled.mean() > GREEDY:
            background = np.flatnonzero(measured)  # the masks cover the table, too
    if background.size < config.minimum_pixels:
        return None
    around = flat.take(_thin(background, FIT_POINTS, rng), axis=0)
    groups = _object_points(flat, labels, objects, rng)
    near = _near_objects(around, groups, config.plane_reach)
    if len(near) < config.plane_points // 4:
        near = around
    plane = _best_plane(near, groups, config, rng)
    if plane is None:
        return None
    normal, offset = plane
    ratio = float((np.abs(around @ normal + offset) < config.plane_threshold).mean())
    return SupportPlane(normal.astype(np.float64), float(offset), ratio, config.plane_threshold)


def _thin(indices: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """At most `count` of the indices, spread evenly with a random start, in order."""
    if indices.size <= count:
        return indices
    step = indices.size / count
    return indices[((np.arange(count) + rng.random()) * step).astype(np.int64)]


def _object_points(
    flat: np.ndarray, labels: np.ndarray | None, objects: np.ndarray, rng: np.random.Generator
) -> list[np.ndarray]:
    """A few hundred points of each labelled object, in the order objects are met in the image."""
    if labels is None or objects.size == 0:
        return []
    objects = _thin(objects, FIT_POINTS, rng)
    return [flat.take(objects[group], axis=0) for _, group in group_by_label(labels.reshape(-1)[objects])]


def _near_objects(around: np.ndarray, groups: list[np.ndarray], reach: float) -> np.ndarray:
    """Points within `reach` [m] of the box around each object's middle 80 % (masks bleed)."""
    if not groups:
        return around
    near = np.zeros(len(around), bool)
    columns = np.ascontiguousarray(around.T)
    for group in groups:
        low, high = column_quantiles(group, 0.1, 0.9)
        inside = np.ones(len(around), bool)
        for column, least, most in zip(columns, low - reach, high + reach, strict=True):
            inside &= (column > least) & (column < most)
        near |= inside
    return around[near]


def _best_plane(
    near: np.ndarray, groups: list[np.ndarray], config: PerceptionConfig, rng: np.random.Generator
) -> tuple[np.ndarray, float] | None:
    """Peel planes off one by one and keep the one with the most credit; refined and facing the camera."""
    rest = near[_thin(np.arange(len(near)), config.plane_points, rng)]
    total = len(rest)
    columns = np.ascontiguousarray(near.T, np.float64)
    best: tuple[float, np.ndarray, float] | None = None
    touched: tuple[float, np.ndarray, float] | None = None
    hovering = False
    for _ in range(config.plane_candidates):
        if len(rest) < max(10, config.plane_minimum_share * total):
            break
        normal, offset = _ransac(rest, config, rng)
        inlier = np.abs(rest @ normal + offset) < config.plane_threshold
        share = inlier.sum() / total
        if share < config.plane_minimum_share:
            break
        refined = _refine(columns, normal, offset, config.plane_threshold)
        rest = rest[~inlier]
        if refined is None:
            continue
        normal, offset = refined
        rests, contact = _resting(groups, normal, offset, config)
        carries = rests if groups else _carrying(near, normal, offset, config)
        credit = share * carries * _uprightness(normal)
        if credit < MINIMUM_CREDIT:
            continue
        if not groups:
            credit /= offset  # of a table and the floor beneath it, the nearer one is meant
        if best is None or credit > best[0]:
            best, hovering = (credit, normal, offset), contact < HOVERING
        if contact > CONTACT and _uprightness(normal) > UPRIGHT and (touched is None or contact > touched[0]):
            touched = (contact, normal, offset)
    if best is None:
        return None
    _, normal, offset = best
    if touched is None or abs(float(touched[1] @ normal)) > ACROSS:
        return normal, offset
    return touched[1:] if hovering else (normal, offset)


def _ransac(
    points: np.ndarray, config: PerceptionConfig, rng: np.random.Generator
) -> tuple[np.ndarray, float]:
    import open3d as o3d

    o3d.utility.random.seed(int(rng.integers(2**31)))
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(np.float64)))
    # probability=1 switches off Open3D's early stop, which depends on how its threads race.
    model, _ = cloud.segment_plane(config.plane_threshold, 3, config.plane_iterations, 1.0)
    return np.asarray(model[:3]), float(model[3])


def _refine(
    columns: np.ndarray, normal: np.ndarray, offset: float, threshold: float
) -> tuple[np.ndarray, float] | None:
    """Least squares on the inliers, tightened once; None when they are a sliver or no plane at all.

    columns: (3, N) float64 [m], in which sums over all points take a tenth of the time.
    """
    for limit in (threshold, 0.6 * threshold):
        inliers = columns.compress(np.abs(normal @ columns + offset) < limit, axis=1)
        count = inliers.shape[1]
        if count < 3:
            return None
        centre = inliers.mean(1)
        inliers -= centre[:, None]
        spread, axes = np.linalg.eigh(inliers @ inliers.T / (count - 1))
        if spread[1] < MINIMUM_SPREAD**2:
            return None
        normal = axes[:, 0]
        offset = -float(normal @ centre)
    distance = np.abs(normal @ columns + offset)
    if (distance < threshold).sum() < LEAST_PEAK * (distance < 2 * threshold).sum():
        return None
    # The camera is at the origin, on the positive side of the plane it sees.
    return (normal, offset) if offset > 0 else (-normal, -offset)


def _resting(
    groups: list[np.ndarray], normal: np.ndarray, offset: float, config: PerceptionConfig
) -> tuple[float, float]:
    """How well the objects stand on the plane, in 0..1: above it, and with their lowest points near it.

    The second figure does not allow for feet that nobody can see from straight above. Without objects, 0.
    """
    if not groups:
        return 0.0, 0.0
    scores = []
    for group in groups:
        height = group @ normal + offset
        above = max(0.0, 2 * float((height > -config.plane_threshold).mean()) - 1)
        gap = max(0.0, float(quantiles(height, 0.05)[0]))
        middle = group.mean(0)
        steep = abs(float(middle @ normal)) / max(float(np.linalg.norm(middle)), 1e-9)
        # Seen from straight above, an object hides its own foot: a gap says nothing then.
        hidden = max(0.0, steep - STEEP) / (1 - STEEP)
        rests = [REST_LENGTH * (1 + HIDDEN_FOOT * allowed) for allowed in (hidden, 0.0)]
        scores.append([above * np.exp(-((gap / rest) ** 2)) for rest in rests])
    rests_well, in_contact = np.mean(scores, axis=0).tolist()
    return rests_well, in_contact


def _carrying(points: np.ndarray, normal: np.ndarray, offset: float, config: PerceptionConfig) -> float:
    """Without labels: how much stands on the plane, in 0.2..1: within reach above the part that is seen."""
    height = points @ normal + offset
    inlier = np.abs(height) < config.plane_threshold
    centre = points[inlier].mean(0)
    inverse = np.linalg.pinv(np.cov((points[inlier] - centre).T), rcond=1e-4, hermitian=True)
    foot = points - height[:, None] * normal - centre
    over = np.einsum("ij,jk,ik->i", foot, inverse, foot) < FOOTPRINT**2
    standing = over & (height > config.segment_height) & (height < config.segment_reach)
    return 0.2 + 0.8 * min(1.0, float(standing.mean()) / CLUTTER_SHARE)


def _uprightness(normal: np.ndarray) -> float:
    """A mild preference for planes that face the image's top: tables rather than walls behind them."""
    return 0.5 + 0.5 * max(0.0, -float(normal[1]))
