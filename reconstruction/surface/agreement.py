"""Does a mesh agree with the depth image it comes from? Measured on the rays, without any truth.

Knows meshes and one depth image in one frame; knows nothing of how either was made.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from perception.camera import Camera, transform
from perception.ray_casting import ray_scene, tensor

WITHIN = 0.003
"""A ray agrees where it first meets its object's mesh this near to the measured depth [m]."""
EARLY = 2.0
"""A ray is early where a mesh stops it more than this many times the tolerance before what it measured."""
LEAST_AGREEMENT = 0.9
"""An object whose rays agree less often than this contradicts its depth image."""
MOST_EARLY = 0.03
"""An object that stops more rays too early than this, per labelled pixel, contradicts the depth image."""


@dataclass(frozen=True)
class Agreement:
    """What the depth image says of one object's mesh.

    pixels: labelled pixels with a measured depth; agreement: share of them whose ray first meets the mesh
    within `tolerance` [m] of the depth; early_rays: rays of the whole image that the mesh stops more than
    twice that before what they measured, per labelled pixel. Both are NaN without pixels.
    """

    pixels: int
    agreement: float
    early_rays: float
    tolerance: float

    @property
    def contradicts(self) -> bool:
        """Whether the mesh is not to be trusted where it was seen."""
        return bool(self.agreement < LEAST_AGREEMENT or self.early_rays > MOST_EARLY)


def agreement_with_depth(
    meshes: Mapping[int, trimesh.Trimesh],
    labels: np.ndarray,
    depth: np.ndarray,
    camera: Camera,
    T_camera_mesh: np.ndarray,
    tolerance: float = WITHIN,
) -> dict[int, Agreement]:
    """The agreement of each mesh with a depth image, by label.

    meshes: by label, in a frame that T_camera_mesh (4, 4) leads to the camera from. labels: (H, W);
    depth: (H, W) [m] along z, NaN or 0 where nothing was measured; tolerance [m].
    """
    depth = np.where(depth > 0, depth, np.nan).astype(np.float32)
    return {
        label: _of_one(label, mesh, labels, depth, camera, T_camera_mesh, tolerance)
        for label, mesh in meshes.items()
    }


def together(found: Sequence[Agreement]) -> Agreement:
    """The agreement of one mesh with several depth images: that of all their pixels."""
    seen = [one for one in found if one.pixels]
    pixels = sum(one.pixels for one in seen)
    if not pixels:
        return found[0]
    agreement = sum(one.pixels * one.agreement for one in seen) / pixels
    early = sum(one.pixels * one.early_rays for one in seen) / pixels
    return Agreement(pixels, agreement, early, seen[0].tolerance)


def depth_of_mesh(
    mesh: trimesh.Trimesh, camera: Camera, T_camera_mesh: np.ndarray
) -> tuple[tuple[slice, slice], np.ndarray]:
    """The part of the image that can see a mesh, and the depth (h, w) float32 [m] along z at which its rays
    first meet it, infinite where they never do."""
    vertices = transform(T_camera_mesh, np.asarray(mesh.vertices))
    part = _seen_part(vertices, camera)
    scene = ray_scene([(vertices, mesh.faces)])
    directions = camera.rays[part]
    rays = np.concatenate([np.zeros_like(directions), directions], axis=-1)
    # Directions have z = 1, so the distance along a ray is its depth.
    return part, scene.cast_rays(tensor(rays))["t_hit"].numpy()


def _of_one(
    label: int,
    mesh: trimesh.Trimesh,
    labels: np.ndarray,
    depth: np.ndarray,
    camera: Camera,
    T_camera_mesh: np.ndarray,
    tolerance: float,
) -> Agreement:
    part, met = depth_of_mesh(mesh, camera, T_camera_mesh)
    pixels = int(((labels == label) & np.isfinite(depth)).sum())
    if pixels == 0:
        return Agreement(0, float("nan"), float("nan"), tolerance)
    gap = depth[part] - met  # NaN where nothing was measured, -inf where nothing is met
    agrees = (np.abs(gap) <= tolerance) & (labels[part] == label)
    early = gap > EARLY * tolerance
    return Agreement(pixels, float(agrees.sum() / pixels), float(early.sum() / pixels), tolerance)


def _seen_part(vertices: np.ndarray, camera: Camera) -> tuple[slice, slice]:
    """Rows and columns of the pixels that may see something of vertices (V, 3) [m] in the camera frame."""
    if len(vertices) == 0 or vertices[:, 2].min() <= 0:
        return slice(0, camera.height), slice(0, camera.width)
    pixel, _ = camera.project(vertices)
    low = np.clip(np.floor(pixel.min(0)).astype(int), 0, [camera.width, camera.height])
    high = np.clip(np.ceil(pixel.max(0)).astype(int) + 1, 0, [camera.width, camera.height])
    return slice(low[1], high[1]), slice(low[0], high[0])
