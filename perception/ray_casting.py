"""Surfaces for Open3D's ray casting: the one place where triangles and points become its tensors.

Knows arrays; knows nothing of frames, objects or what the rays are for.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np


def ray_scene(surfaces: Iterable[tuple[np.ndarray, np.ndarray]]) -> Any:
    """An open3d RaycastingScene of surfaces: vertices (V, 3) [m] and faces (F, 3) each, numbered from 0.

    It works in single precision: keep the origin near.
    """
    import open3d

    scene = open3d.t.geometry.RaycastingScene()
    for vertices, faces in surfaces:
        indices = open3d.core.Tensor.from_numpy(np.ascontiguousarray(faces, np.uint32))
        scene.add_triangles(tensor(vertices), indices)
    return scene


def tensor(values: np.ndarray) -> Any:
    """An array as open3d takes it: float32."""
    import open3d

    return open3d.core.Tensor.from_numpy(np.ascontiguousarray(values, np.float32))
