"""The planner that reads truncated distances: VGN on cubes of the scene, as measured or completed by meshes.

Knows shapes, cubes and the network; knows nothing of physics or truth.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from reconstruction.export.vgn import FLOOR, SIDE, VOXELS, completed
from reconstruction.export.virtual_views import truncated_distances
from tools.grasping.hand import Grasp
from tools.grasping.shapes import Shapes
from tools.grasping.vgn_network import Network, chosen_voxels

REACH = 0.10
"""A cube shows what an object this far from its middle, along x and y, needs [m]."""
TIPS = 0.045
"""The fingers' tips lie this far ahead of the network's reference point [m]; found by trial."""


def plan(shapes: Shapes, network: Network) -> Grasp | None:
    """The grasp of highest quality in any cube; None when none passes the network's threshold.

    Shapes that are meshes are seen from all around, clouds as the frame saw them.
    """
    best: Grasp | None = None
    for middle in _middles(shapes):
        T_world_cube = np.eye(4)
        T_world_cube[:3, 3] = [*(middle - SIDE / 2), -FLOOR]
        tsdf = _tsdf(shapes, middle, T_world_cube)
        quality, turns, widths = network(tsdf)
        for index, score in zip(*chosen_voxels(tsdf, quality, widths)):
            if best is not None and score <= best.score:
                continue
            T = np.eye(4)
            T[:3, :3] = Rotation.from_quat(turns[tuple(index)]).as_matrix()
            T[:3, 3] = T_world_cube[:3, 3] + SIDE / VOXELS * index + TIPS * T[:3, 2]
            best = Grasp(T, float(SIDE / VOXELS * widths[tuple(index)]), float(score))
    return best


def _tsdf(shapes: Shapes, middle: np.ndarray, T_world_cube: np.ndarray) -> np.ndarray:
    if shapes.meshes:
        floor = np.array([*middle, 0.0])
        return completed(list(shapes.meshes.values()), np.eye(4), floor, T_world_cube)
    measured = [(np.nan_to_num(shapes.frame.depth), shapes.frame.camera)]
    return truncated_distances(measured, T_world_cube, SIDE, VOXELS)


def _middles(shapes: Shapes) -> list[np.ndarray]:
    """Middles (2,) [m] of few cubes that together hold all objects."""
    bounds = [mesh.bounds for mesh in shapes.meshes.values()]
    bounds += [np.array([c.points.min(0), c.points.max(0)]) for c in shapes.clouds.values()]
    centres = np.array([box.mean(0)[:2] for box in bounds]).reshape(-1, 2)
    left = np.ones(len(centres), bool)
    found = []
    while left.any():
        tried = np.concatenate([[centres[left].mean(0)], centres[left]])
        shown = (np.abs(centres - tried[:, None]) <= REACH).all(-1) & left
        best = int(shown.sum(1).argmax())
        found.append(tried[best])
        left &= ~shown[best]
    return found
