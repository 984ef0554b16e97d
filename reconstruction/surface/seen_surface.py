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

    def below(self, pixel: np.ndarray, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far points, as coordinates (3, N) float32 [m], lie behind the planes of pixels (N,), and the
        planes' c (N,) [m], 0 where there is none."""
        # One number of 16 bytes a plane: they are fetched in one go.
        plane = self.planes.view(np.complex128).reshape(-1).take(pixel).view(np.float32).reshape(-1, 4)
        nx, ny, nz, c = plane.T
        x, y, z = axes
        return nx * x + (ny * y + nz * z) - c, c

    def edges(self, index: int) -> Edges:
        """The edges of one object's image."""
        return Edges.of(self, index)


@dataclass(frozen=True)
class Edges:
    """Where an object's image ends, or jumps to a farther part of it.

    Nearest pixels are looked up in a part of the image that starts at (top, left): near (h, w) gives the flat
    index of the nearest pixel on the near side of an edge, far (h, w) on its far side; -1 if there is none,
    as all along the part's border.
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
        near, far = (np.pad(_nearest(pixels, flat), 1, constant_values=-1) for pixels in (near, far))
        return cls(seen, index, top - 1, left - 1, near, far)

    def read(self, points: np.ndarray) -> Reading:
        """What the depth image says of points (N, 3) float32 [m]."""
        seen, camera = self.seen, self.seen.camera
        axes = np.ascontiguousarray(points.T)  # each coordinate in one piece
        A, b = seen.projection
        u, v, z = A @ axes + b[:, None]
        np.maximum(z, np.float32(1e-4), out=z)
        u /= z
        v /= z
        column, row = np.rint(u).astype(np.int32), np.rint(v).astype(np.int32)
        inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
        pixel = np.where(inside, row * np.int32(camera.width) + column, 0)
        owner = seen.owner.reshape(-1).take(pixel)
        owner[~inside] = NOT_MEASURED
        behind, _ = seen.below(pixel, axes)
        # The table and the room need no planes: nothing is built on them.
        behind = np.where(owner == BACKGROUND, z - seen.depth.reshape(-1).take(pixel), behind)
        measured = owner > NOT_MEASURED
        behind[~measured] = FAR
        owned = owner == self.index
        free = measured & (behind < 0)
        lateral = self._beside(axes, u, v, z, row, column, free)
        # Behind what is not its own, nothing is known of this object.
        distance = np.where(free, np.maximum(behind, -lateral), np.minimum(behind, lateral))
        distance[~(free | owned)] = FAR
        np.minimum(distance, self.above_floor(axes[2]), out=distance)
        depth = np.where(owned & ~free, behind, np.float32(FAR))
        return Reading(distance, depth, np.where((owner >= 0) & ~owned, behind, np.float32(FAR)))

    def behind(self, points: np.ndarray, distance: float) -> np.ndarray:
        """Points (N, 3) moved by `distance` [m] away from the camera."""
        T = self.seen.T_camera_table
        rays = points - (-T[:3, :3].T @ T[:3, 3]).astype(np.float32)
        x, y, z = rays.T
        rays *= (np.float32(distance) / np.sqrt(x * x + (y * y + z * z)))[:, None]
        return points + rays

    def above_floor(self, height: np.ndarray) -> np.ndarray:
        """How far heights (N,) are above the floor [m], FAR where none is known."""
        if self.seen.floors is None:
            return np.full(len(height), np.float32(FAR))
        return height - np.float32(self.seen.floors[self.index])

    def _beside(
        self,
        axes: np.ndarray,
        u: np.ndarray,
        v: np.ndarray,
        z: np.ndarray,
        row: np.ndarray,
        column: np.ndarray,
        free: np.ndarray,
    ) -> np.ndarray:
        """Distance (N,) [m] across the image to the nearest edge that matters at a point's depth, or FAR.

        axes: (3, N) float32 coordinates of the points [m].
        """
        seen, camera = self.seen, self.seen.camera
        height, width = self.near.shape
        # The part's outermost pixels have no edge near: whatever lies beyond is taken for one of them.
        place = np.clip(row - np.int32(self.top), 0, height - 1) * np.int32(width)
        place += np.clip(column - np.int32(self.left), 0, width - 1)
        edge = np.where(free, self.near.reshape(-1).take(place), self.far.reshape(-1).take(place))
        here = np.flatnonzero(edge >= 0)
        edge, of_free, depth = edge[here], free[here], z[here]
        # Free space beyond an edge matters to a point that lies before the surface there.
        below, offset = seen.below(edge, axes[:, here])
        before = np.where(offset != 0, below < 0, depth < seen.depth.reshape(-1).take(edge))
        edge_row = edge // np.int32(camera.width)
        du = u[here] - (edge - edge_row * np.int32(camera.width)).astype(np.float32)
        dv = v[here] - edge_row.astype(np.float32)
        pixels = np.maximum(np.sqrt(du * du + dv * dv) - np.float32(0.5), 0)
        focal = np.float32(min(camera.K[0, 0], camera.K[1, 1]))
        across = np.maximum(pixels * depth / focal, np.float32(LEAST_LATERAL))
        # A free point before the surface that ends there is so much farther from it.
        below = np.minimum(below, 0) * of_free
        lateral = np.full(len(u), np.float32(FAR))
        lateral[here] = np.where(of_free | before, np.sqrt(across * across + below * below), np.float32(FAR))
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
