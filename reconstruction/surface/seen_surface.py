"""What was measured, as a signed distance: how far a point lies behind what the camera saw, object by object.

Knows one observation; knows nothing of maps, lattices or meshes. Points are in the table frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from perception.camera import Camera, invert_rigid
from perception.config import PerceptionConfig
from perception.depth_edges import depth_jump
from perception.observation import Observation
from reconstruction.surface.smooth_depth import surface_planes

NOT_MEASURED = -2
BACKGROUND = -1
"""Owners of pixels that are no object's: without depth, and of the table or the room."""
FAR = 0.1
"""Distances beyond this do not matter to any surface [m]."""
BORDER = 6
"""Pixels around an object in which the distance to its silhouette is worked out."""
SAME_DEPTH = 0.002
"""Beside an object's edge, a surface this much farther away is beyond the edge [m]; within an object, the
jump must be one that no slanted surface explains."""
LEAST_LATERAL = 5e-5
"""Points exactly on the edge are beside it [m]."""


class Reading(NamedTuple):
    """What the depth image says of N points, for one object.

    distance: (N,) float32 [m] behind the measured surface or beside the silhouette, negative in free space
    and below the floor, FAR where nothing is known. depth: (N,) float32 [m] below the object's own surface,
    FAR where it is not seen. others: (N,) float32 [m] below the surface of another object seen there, else
    FAR.
    """

    distance: np.ndarray
    depth: np.ndarray
    others: np.ndarray


@dataclass(frozen=True)
class SeenSurface:
    """All measured surfaces of one observation.

    owner: (H, W) int32 index of the object a pixel belongs to, BACKGROUND or NOT_MEASURED;
    depth: (H, W) float32 [m]; planes: (H * W, 4) float32, (n, c) of the plane n . x = c each pixel sees,
    n away from the camera, zero where no object was measured; noise: of the depth at 1 m [m]; floors: each
    object is above its height [m], None where unknown.
    """

    camera: Camera
    T_camera_table: np.ndarray
    owner: np.ndarray
    depth: np.ndarray
    planes: np.ndarray
    noise: float
    floors: Sequence[float] | None

    @classmethod
    def of(
        cls,
        observation: Observation,
        raw_depth: np.ndarray | None = None,
        floors: Sequence[float] | None = None,
    ) -> SeenSurface:
        """The surfaces that an observation shows.

        raw_depth: (H, W) [m] before pixels between two surfaces were removed: rays passed as far as those,
        too. None: the observation's own. floors: no object is below its height [m].
        """
        camera, depth = observation.camera, observation.depth
        if raw_depth is not None:
            depth = np.where(np.isfinite(depth), depth, raw_depth)
        owner = np.where(np.isfinite(depth), BACKGROUND, NOT_MEASURED).astype(np.int32)
        flat = owner.reshape(-1)
        for index, item in enumerate(observation.objects):
            flat[item.pixels] = index
        pixels = np.flatnonzero(flat >= 0)
        own, noise = surface_planes(depth, owner + 3, pixels, camera)
        T = invert_rigid(observation.T_table_camera)
        planes = np.zeros((depth.size, 4), np.float32)
        planes[pixels, :3] = own[:, :3] @ T[:3, :3].astype(np.float32)
        planes[pixels, 3] = own[:, 3] - own[:, :3] @ T[:3, 3].astype(np.float32)
        return cls(camera, T, owner, depth, planes, noise, floors)

    @cached_property
    def projection(self) -> tuple[np.ndarray, np.ndarray]:
        """A (3, 3) and b (3,) float32 with A x + b = (u z, v z, z)."""
        P = self.camera.K @ self.T_camera_table[:3]
        return P[:, :3].astype(np.float32), P[:, 3].astype(np.float32)

    def edges(self, index: int) -> Edges:
        """The edges of one object's image."""
        return Edges.of(self, index)


@dataclass(frozen=True)
class Edges:
    """Where an object's image ends, or jumps to a farther part of it.

    Nearest pixels are looked up in a part of the image that starts at (top, left): near (h, w) gives the flat
    index of the nearest pixel on the near side of an edge, far (h, w) on its far side; -1 if there is none.
    """

    seen: SeenSurface
    index: int
    top: int
    left: int
    near: np.ndarray
    far: np.ndarray

    @classmethod
    def of(cls, seen: SeenSurface, index: int) -> Edges:
        own = seen.owner == index
        rows, columns = np.flatnonzero(own.any(1)), np.flatnonzero(own.any(0))
        height, width = own.shape
        top, left = max(rows[0] - BORDER, 0), max(columns[0] - BORDER, 0)
        part = (
            slice(top, min(rows[-1] + BORDER + 1, height)),
            slice(left, min(columns[-1] + BORDER + 1, width)),
        )
        near, far = _edge_pixels(own[part], seen.depth[part], seen.camera)
        flat = np.arange(height * width, dtype=np.int32).reshape(height, width)[part]
        return cls(seen, index, top, left, _nearest(near, flat), _nearest(far, flat))

    def read(self, points: np.ndarray) -> Reading:
        """What the depth image says of points (N, 3) float32 [m]."""
        seen, camera = self.seen, self.seen.camera
        A, b = seen.projection
        u, v, z = A @ points.T + b[:, None]
        z = np.maximum(z, np.float32(1e-4))
        u /= z
        v /= z
        column, row = np.rint(u).astype(np.int32), np.rint(v).astype(np.int32)
        inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        pixel = np.where(inside, row * camera.width + column, 0)
        owner = np.where(inside, seen.owner.reshape(-1)[pixel], NOT_MEASURED)
        measured = owner > NOT_MEASURED
        plane = seen.planes[pixel]
        behind = (plane[:, :3] * points).sum(1) - plane[:, 3]
        # The table and the room need no planes: nothing is built on them.
        behind = np.where(owner == BACKGROUND, z - seen.depth.reshape(-1)[pixel], behind)
        behind[~measured] = FAR
        owned = owner == self.index
        free = measured & (behind < 0)
        lateral = self._beside(points, u, v, z, row, column, free)
        # Behind what is not its own, nothing is known of this object.
        known = free | owned
        distance = np.where(free, -np.minimum(-behind, lateral), np.minimum(behind, lateral))
        distance = np.where(known, distance, np.float32(FAR))
        distance = np.minimum(distance, self.above_floor(points[:, 2]))
        depth = np.where(owned & ~free, behind, np.float32(FAR))
        return Reading(distance, depth, np.where((owner >= 0) & ~owned, behind, np.float32(FAR)))

    def behind(self, points: np.ndarray, distance: float) -> np.ndarray:
        """Points (N, 3) moved by `distance` [m] away from the camera."""
        T = self.seen.T_camera_table
        rays = points - (-T[:3, :3].T @ T[:3, 3]).astype(np.float32)
        rays *= np.float32(distance) / np.sqrt((rays * rays).sum(1, keepdims=True))
        return points + rays

    def above_floor(self, height: np.ndarray) -> np.ndarray:
        """How far heights (N,) are above the floor [m], FAR where none is known."""
        if self.seen.floors is None:
            return np.full(len(height), np.float32(FAR))
        return height - np.float32(self.seen.floors[self.index])

    def _beside(
        self,
        points: np.ndarray,
        u: np.ndarray,
        v: np.ndarray,
        z: np.ndarray,
        row: np.ndarray,
        column: np.ndarray,
        free: np.ndarray,
    ) -> np.ndarray:
        """Distance (N,) [m] across the image to the nearest edge that matters at a point's depth, or FAR."""
        seen, camera = self.seen, self.seen.camera
        height, width = self.near.shape
        r, c = row - self.top, column - self.left
        lateral = np.full(len(u), np.float32(FAR))
        inside = (r >= 0) & (r < height) & (c >= 0) & (c < width)
        place = np.where(inside, r * width + c, 0)
        edge = np.where(free, self.near.reshape(-1)[place], self.far.reshape(-1)[place])
        here = np.flatnonzero(inside & (edge >= 0))
        edge, of_free = edge[here], free[here]
        depth = seen.depth.reshape(-1)[edge]
        # Free space beyond an edge matters to a point that lies before the surface there.
        plane = seen.planes[edge]
        below = (plane[:, :3] * points[here]).sum(1) - plane[:, 3]
        before = np.where(plane[:, 3] != 0, below < 0, z[here] < depth)
        matters = of_free | before
        here, edge, below = here[matters], edge[matters], np.where(of_free, below, 0)[matters]
        du = u[here] - edge % camera.width
        dv = v[here] - edge // camera.width
        pixels = np.maximum(np.hypot(du, dv) - 0.5, 0)
        focal = np.float32(min(camera.K[0, 0], camera.K[1, 1]))
        across = np.maximum(pixels * z[here] / focal, LEAST_LATERAL)
        # A free point before the surface that ends there is so much farther from it.
        lateral[here] = np.hypot(across, np.minimum(below, 0))
        return lateral


def _edge_pixels(own: np.ndarray, depth: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (h, w) bool on the near side of an edge of an object's image own (h, w), and on its far side."""
    jump = depth_jump(depth, camera, PerceptionConfig())
    near, far = np.zeros_like(own), np.zeros_like(own)
    height, width = own.shape
    for dv, du in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a = slice(0, height - dv), slice(max(0, -du), width - max(0, du))
        b = slice(dv, height), slice(max(0, du), width + min(0, du))
        for one, other in ((a, b), (b, a)):
            limit = np.where(own[other], jump[one], np.float32(SAME_DEPTH))
            with np.errstate(invalid="ignore"):
                edge = own[one] & (depth[other] - depth[one] > limit)
            near[one] |= edge
            far[other] |= edge
    return near, far


def _nearest(pixels: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Of each place (h, w) the nearest of some pixels (h, w) bool, as its value in `flat`; -1 where none is
    within BORDER."""
    import cv2

    if not pixels.any():
        return np.full(flat.shape, -1, np.int32)
    distance, number = cv2.distanceTransformWithLabels(
        (~pixels).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    # OpenCV numbers the pixels; which number is whose stands at the pixels themselves.
    of_number = np.zeros(int(number.max()) + 1, np.int32)
    of_number[number[pixels]] = flat[pixels]
    return np.where(distance <= BORDER, of_number[number], -1)
