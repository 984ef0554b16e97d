"""What was measured, as a signed distance: how far a point lies behind what the camera saw, object by object.

Knows one observation; knows nothing of maps, lattices or meshes. Points are in the table frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mapping.compiled import compiled
from perception.camera import Camera, invert_rigid
from perception.observation import Observation
from reconstruction.surface.image_edges import BORDER, box_of, edge_pixels, nearest_of
from reconstruction.surface.reading import (
    BACKGROUND,
    FAR,
    NOT_MEASURED,
    Image,
    Outline,
    Reading,
    faced,
    lower_near,
    read_into,
    read_points,
)
from reconstruction.surface.smooth_depth import surface_planes


@compiled
def _put_planes(planes: np.ndarray, pixels: np.ndarray, own: np.ndarray, T: np.ndarray) -> None:
    """Planes (H W, 4) of pixels (N,) in the table's frame from those (N, 4) in the camera's; T: table to
    camera."""
    for n in range(len(pixels)):
        pixel = pixels[n]
        x, y, z, c = own[n, 0], own[n, 1], own[n, 2], own[n, 3]
        for axis in range(3):
            planes[pixel, axis] = x * T[0, axis] + y * T[1, axis] + z * T[2, axis]
        planes[pixel, 3] = c - (x * T[0, 3] + y * T[1, 3] + z * T[2, 3])


@dataclass(frozen=True)
class SeenSurface:
    """All measured surfaces of one observation.

    owner: (H, W) int32 index of the object a pixel belongs to, BACKGROUND or NOT_MEASURED;
    depth: (H, W) float32 [m]; planes: (H * W, 4) float32, (n, c) of the plane n . x = c each pixel sees,
    n away from the camera, zero where no object was measured; noise: of the depth at 1 m [m]; floors: each
    object is above its height [m], None where unknown; boxes: rows and columns of each object.
    """

    camera: Camera
    T_camera_table: np.ndarray
    owner: np.ndarray
    depth: np.ndarray
    planes: np.ndarray
    noise: float
    floors: Sequence[float] | None
    boxes: list[tuple[slice, slice]]

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
        _put_planes(planes, pixels, own, T.astype(np.float32))
        boxes = [box_of(item.pixels, camera.width) for item in observation.objects]
        return cls(camera, T, owner, depth, planes, noise, floors, boxes)

    @cached_property
    def image(self) -> Image:
        """The same as points see it."""
        P, K = (self.camera.K @ self.T_camera_table[:3]).astype(np.float32), self.camera.K
        focal = np.float32(min(K[0, 0], K[1, 1]))
        A, b = np.ascontiguousarray(P[:, :3]), np.ascontiguousarray(P[:, 3])
        return Image(A, b, focal, self.owner, self.depth.astype(np.float32, copy=False), self.planes)

    def edges(self, index: int) -> Edges:
        """The edges of one object's image; the same when asked again."""
        if index not in self._edges:
            self._edges[index] = Edges.of(self, index)
        return self._edges[index]

    @cached_property
    def _edges(self) -> dict[int, Edges]:
        return {}


def seen_by(observation: Observation, raw_depth: np.ndarray) -> SeenSurface:
    """The surfaces that an observation shows, the same when asked again with its own depth image."""
    memo = observation.memo
    if "surface" not in memo:
        memo["surface"] = SeenSurface.of(observation, raw_depth)
    seen: SeenSurface = memo["surface"]
    return seen


@dataclass(frozen=True)
class Edges:
    """Where an object's image ends, or jumps to a farther part of it.

    nearest: (2, h, w) int32, for a part of the image that starts at (top, left): number of the nearest pixel
    on the near side of an edge, and of the nearest on its far side; 0 if there is none, as all along the
    part's border. distances: (2, h, w) float32, how far those are [px]; planes: (E, 4) float32 what each
    number's pixel sees.
    """

    seen: SeenSurface
    index: int
    top: int
    left: int
    nearest: np.ndarray
    distances: np.ndarray
    planes: np.ndarray

    @classmethod
    def of(cls, seen: SeenSurface, index: int) -> Edges:
        if index < 0:  # an object that this view does not see: free space is all there is to read
            none, far = np.zeros((2, 3, 3), np.int32), np.full((2, 3, 3), BORDER + 1, np.float32)
            return cls(seen, index, 0, 0, none, far, np.zeros((1, 4), np.float32))
        height, width = seen.owner.shape
        rows, columns = seen.boxes[index]
        top, left = max(rows.start - BORDER, 0), max(columns.start - BORDER, 0)
        part = (
            slice(top, min(rows.stop + BORDER, height)),
            slice(left, min(columns.stop + BORDER, width)),
        )
        own = seen.owner[part] == index
        sides = edge_pixels(own, seen.depth[part], seen.camera)
        nearest = np.zeros((2, *(n + 2 for n in own.shape)), np.int32)
        distances = np.empty(nearest.shape, np.float32)
        at = [np.empty(0, np.int64)]
        for number, side in enumerate(sides):
            found, away, pixels = nearest_of(side)
            nearest[number, 1:-1, 1:-1] = np.where(found > 0, found + len(np.concatenate(at)), 0)
            distances[number] = np.pad(away, 1, "edge")  # as far beyond the image's border as at it
            at.append(pixels)
        row, column = np.divmod(np.concatenate(at), sides[0].shape[1])
        planes = np.zeros((1 + len(row), 4), np.float32)
        pixel = (row + top) * width + column + left
        planes[1:] = seen.planes[pixel]
        # What is no object's has no plane: it is taken to face the camera, where it was measured.
        T, depth = seen.T_camera_table, seen.depth.reshape(-1)[pixel]
        bare = 1 + np.flatnonzero((planes[1:, 3] == 0) & np.isfinite(depth))
        planes[bare, :3], planes[bare, 3] = T[2, :3], depth[bare - 1] - T[2, 3]
        return cls(seen, index, top - 1, left - 1, nearest, distances, planes)

    def read(self, points: np.ndarray) -> Reading:
        """What the depth image says of points (N, 3) float32 [m]."""
        points = np.ascontiguousarray(points, np.float32)
        return Reading(*read_points(points, self.seen.image, self.outline))

    def read_into(self, points: np.ndarray, reading: np.ndarray) -> None:
        """Fill (3, N) float32 with the arrays of the Reading of points (N, 3) float32 in one piece [m]."""
        read_into(points, self.seen.image, self.outline, *reading)

    @cached_property
    def outline(self) -> Outline:
        """The same as points see it."""
        floor = -np.inf if self.seen.floors is None else self.seen.floors[self.index]
        places = self.top, self.left, self.nearest, self.distances, self.planes
        return Outline(self.index, np.float32(floor), *places)

    @cached_property
    def usual_depth(self) -> float:
        """The median depth of what is seen of the object [m], infinite where it is not seen."""
        if self.index < 0:
            return np.inf
        part = self.seen.boxes[self.index]
        return float(np.median(self.seen.depth[part][self.seen.owner[part] == self.index]))

    @property
    def noise(self) -> float:
        """Standard deviation of what is measured of the object [m], 0 where it is not seen."""
        return self.seen.noise * self.usual_depth**2 if self.index >= 0 else 0.0

    def facing(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of what the object shows on the ray through each point: the normal (N, 3) away from the camera, 0
        where it shows nothing there, and how far the point is behind it (N,) [m], 0 there."""
        points = np.ascontiguousarray(points, np.float32)
        normals, behind = faced(points, self.seen.image, self.index)
        return normals, behind

    def lower_near(self, points: np.ndarray, within: float, rim: float, share: np.ndarray) -> None:
        """Lower share (N,) float32 at points (N, 3) float32 in one piece [m] that are near what the object
        shows on their ray: to 0 there, linearly to 1 at a distance of `within` [m], and from `rim` [px] to
        `rim` - 1 from the outermost pixels of its image."""
        lower_near(points, self.seen.image, self.outline, np.float32(within), np.float32(rim), share)

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
