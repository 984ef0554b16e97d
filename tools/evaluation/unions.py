"""Figures of several closed meshes taken as one: the union of what single views made of an object.

Knows meshes; knows nothing of frames or maps.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh

from reconstruction.metrics import iou, sample_surface
from reconstruction.solid import Solid

FINEST = 0.0025
"""Grid of the IoU [m]."""
SAMPLES = 10_000
"""Points drawn on each surface."""


def surface_of_union(parts: Sequence[trimesh.Trimesh], rng: np.random.Generator) -> np.ndarray:
    """About SAMPLES points (N, 3) on the surface of the union of closed meshes."""
    areas = np.array([part.area for part in parts])
    points = []
    for index, (part, area) in enumerate(zip(parts, areas)):
        of_one = sample_surface(part, max(1, int(SAMPLES * area / areas.sum())), rng)
        for other, hider in enumerate(parts):
            if other != index:
                of_one = of_one[~Solid(hider).inside(of_one.astype(np.float32))]
        points.append(of_one)
    return np.concatenate(points)


def iou_of_union(parts: Sequence[trimesh.Trimesh], true: Solid) -> float:
    """IoU of the union of closed meshes with the true shape on a grid of FINEST."""
    lows, highs = zip(*(mesh.bounds for mesh in (*parts, true.mesh)))
    axes = [np.arange(a + FINEST / 2, b, FINEST) for a, b in zip(np.min(lows, 0), np.max(highs, 0))]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3).astype(np.float32)
    inside = np.any([Solid(part).inside(grid) for part in parts], axis=0)
    return iou(inside, true.inside(grid))
