"""The classical baseline: a truncated signed distance field of each object's masked depth (Open3D)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from perception.camera import invert_rigid
from perception.observation import Observation
from perception.views.joint_space import each_view
from tools.evaluation.fitted_map import FittedMap, View

VOXEL = 0.005
"""Voxel of the volumes [m]."""
TRUNCATION = 4.0
"""Truncation distance, in voxels."""
BLOCK = 8
"""Voxels a side of Open3D's blocks."""
MARGIN = 0.10
"""Volumes reach this far beyond the visible points [m]."""
FAR = 10.0
"""Depth images are cut here [m]."""


class FittedTsdf(FittedMap):
    """One volume an object, and one of the whole depth image that knows which space was observed.

    An object is where its distance is negative; what no ray reached counts as empty and fully uncertain.
    """

    def __init__(self, view: View) -> None:
        observation = view.observation
        views = [seen for seen, _ in each_view(observation, view.space)]
        self.samples = np.concatenate([item.points for item in observation.objects])
        lows, highs = (np.array(b) for b in zip(*(item.bounds for item in observation.objects)))
        lows, highs = lows - MARGIN, highs + MARGIN
        self.volumes = []
        for item, low, high in zip(observation.objects, lows, highs):
            masked = [_masked(seen, item.label) for seen in views]
            self.volumes.append(DenseTsdf(views, masked, low, high))
        everything = [np.nan_to_num(seen.depth) for seen in views]
        self.scene = DenseTsdf(views, everything, lows.min(0), highs.max(0))

    def predict(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        objects = np.zeros((len(points), len(self.volumes)), np.float32)
        observed = np.zeros(len(points), bool)
        nearest = np.ones(len(points), np.float32)
        for index, volume in enumerate([*self.volumes, self.scene]):
            distance, known = volume.at(points)
            observed |= known
            if index < len(self.volumes):
                objects[:, index] = np.where(known, (1 - distance) / 2, 0)
            nearest = np.where(known, np.minimum(nearest, np.abs(distance)), nearest)
        total = np.maximum(objects.sum(1, keepdims=True), 1)
        probability = np.concatenate([1 - objects.sum(1, keepdims=True) / total, objects / total], 1)
        return probability, np.where(observed, (1 - nearest) / 2, 1).astype(np.float32)


def _masked(observation: Observation, label: int) -> np.ndarray:
    """Depth (H, W) [m] of one object in a view, 0 elsewhere."""
    masked = np.zeros_like(observation.depth)
    for item in observation.objects:
        if item.label == label:
            masked.reshape(-1)[item.pixels] = observation.depth.reshape(-1)[item.pixels]
    return masked


class DenseTsdf:
    """A TSDF over a box in the table frame, from depth images (H, W) [m] a view, 0 is missing (Open3D)."""

    def __init__(
        self,
        views: Sequence[Observation],
        depths: Sequence[np.ndarray],
        low: np.ndarray,
        high: np.ndarray,
    ) -> None:
        import open3d

        core = open3d.core
        shape = core.SizeVector([1])
        grid = open3d.t.geometry.VoxelBlockGrid(
            ("tsdf", "weight"), (core.float32, core.float32), (shape, shape), VOXEL, BLOCK, 1024
        )
        side = VOXEL * BLOCK
        first = np.floor(low / side).astype(np.int32)
        self.shape = np.ceil(high / side).astype(np.int32) - first
        blocks = np.stack(np.meshgrid(*(np.arange(n) for n in self.shape), indexing="ij"), -1).reshape(-1, 3)
        for observation, depth in zip(views, depths):
            grid.integrate(
                core.Tensor.from_numpy(np.ascontiguousarray(blocks + first, np.int32)),
                open3d.t.geometry.Image(np.ascontiguousarray(depth, np.float32)),
                core.Tensor.from_numpy(observation.camera.K.copy()),
                core.Tensor.from_numpy(invert_rigid(observation.T_table_camera)),
                1.0,
                FAR,
                TRUNCATION,
            )
        self.origin = first * side
        self.distance = np.zeros(self.shape * BLOCK, np.float32)
        self.weight = np.zeros(self.shape * BLOCK, np.float32)
        self._unpack(grid)

    def at(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance over the truncation (N,) in [-1, 1] at points (N, 3), and whether it was observed (N,)."""
        from scipy.ndimage import map_coordinates

        voxel = (points - self.origin) / VOXEL
        nearest = np.rint(voxel).astype(int)
        inside = ((nearest >= 0) & (nearest < self.distance.shape)).all(1)
        known = np.zeros(len(points), bool)
        known[inside] = self.weight[tuple(nearest[inside].T)] > 0
        distance = np.ones(len(points), np.float32)
        distance[known] = map_coordinates(self.distance, voxel[known].T, order=1, mode="nearest")
        return distance, known

    def _unpack(self, grid: Any) -> None:
        """From Open3D's hash map of blocks to dense arrays; unobserved voxels count as free."""
        coordinates, index = grid.voxel_coordinates_and_flattened_indices()
        voxel = np.rint((coordinates.numpy() - self.origin) / VOXEL).astype(int)
        flat = index.numpy()
        place = tuple(voxel.T)
        self.weight[place] = grid.attribute("weight").numpy().reshape(-1)[flat]
        self.distance[place] = grid.attribute("tsdf").numpy().reshape(-1)[flat]
        self.distance[self.weight == 0] = 1
