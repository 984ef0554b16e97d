"""Where to look next: the view that is expected to take most p(uncertain) away.

Knows a fitted map, the places of its objects and camera poses; knows nothing of how views come about. A ray
reaches a place with the chance that none of the places before it is part of a thing that the map knows; what
is uncertain is taken to be transparent.
What a view before has shown already, and is uncertain still, another one is not expected to tell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from mapping.errors import ConfigError
from perception.camera import Camera, invert_rigid, transform
from perception.observation import near_boxes
from perception.views.joint import JointObservation

if TYPE_CHECKING:
    from mapping.contramap import ContraMap
    from reconstruction.files.stored import StoredResult
    from reconstruction.result import Reconstruction

SPACING = 0.01
"""Nodes at which p(uncertain) is counted [m]; larger for scenes of more than MOST nodes."""
MOST = 400_000
"""Nodes of the lattice, at most."""
REACH = 0.03
"""Uncertainty counts this far around the objects' meshes [m]."""
LEAST = 0.05
"""Nodes with less p(uncertain) are known already."""
ASKED = 12_000
"""Uncertain nodes that rays are followed to, at most."""
NEAREST = 1.5
"""The ray's last steps before a node do not hide it: they are of the same surface [nodes]."""


@dataclass(frozen=True)
class NextView:
    """What views of a scene are expected to be worth.

    poses: (P, 4, 4) T_world_camera; gains: (P,) share of all p(uncertain) around the objects that each is
    expected to take away; best: index of the greatest, the first of equals.
    """

    poses: np.ndarray
    gains: np.ndarray

    @property
    def best(self) -> int:
        return int(self.gains.argmax())

    @property
    def order(self) -> np.ndarray:
        """Indices of the poses, the most valuable first."""
        return np.argsort(-self.gains, kind="stable")


@dataclass(frozen=True)
class UncertainSpace:
    """The map around objects as rays meet it, in the table frame.

    Node (i, j, k) lies at origin + spacing * (i, j, k) [m]. known: (nx, ny, nz) P(some object) with the
    uncertain class counted against it; points: (M, 3) uncertain nodes with their p(uncertain) weights (M,);
    shown: (M,) how openly views so far see them, 0..1, None for not at all.
    """

    origin: np.ndarray
    spacing: float
    known: np.ndarray
    points: np.ndarray
    weights: np.ndarray
    shown: np.ndarray | None = None

    @classmethod
    def of(
        cls, model: ContraMap, boxes: Sequence[tuple[np.ndarray, np.ndarray]], floor: float | None
    ) -> UncertainSpace:
        """The space around boxes, given by their corners (3,) [m]; nothing counts below the floor."""
        lows, highs = (np.array(ends) for ends in zip(*boxes))
        low, high = lows.min(0) - REACH, highs.max(0) + REACH
        if floor is not None:
            low[2] = max(low[2], floor + SPACING / 2)
        spacing = max(SPACING, float(np.prod(np.maximum(high - low, SPACING)) / MOST) ** (1 / 3))
        axes = tuple(np.arange(a, b + spacing, spacing) for a, b in zip(low, high))
        probability = model.predict_lattice(axes)
        uncertain = probability[..., -1].reshape(-1)
        known = np.clip(1 - probability[..., 0] - probability[..., -1], 0, 1).astype(np.float32)
        nodes = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3).astype(np.float32)
        counted = np.flatnonzero((uncertain > LEAST) & near_boxes(nodes, boxes, REACH))
        counted = counted[:: 1 + len(counted) // ASKED]
        return cls(low, spacing, known, nodes[counted], uncertain[counted])

    def seen_by(self, camera: Camera, T_camera_table: np.ndarray) -> UncertainSpace:
        """The same when a view has been taken."""
        open_ray = self._open(camera, T_camera_table)
        return replace(self, shown=open_ray if self.shown is None else np.maximum(self.shown, open_ray))

    def gain(self, camera: Camera, T_camera_table: np.ndarray) -> float:
        """Share of the uncertainty that a view is expected to take away."""
        if not len(self.points):
            return 0.0
        open_ray = self._open(camera, T_camera_table)
        if self.shown is not None:
            open_ray = np.maximum(open_ray - self.shown, 0)
        return float((self.weights * open_ray).sum() / self.weights.sum())

    def _open(self, camera: Camera, T_camera_table: np.ndarray) -> np.ndarray:
        """How openly a view sees each of the points: (M,) in 0..1."""
        pixel, depth = camera.project(transform(T_camera_table, self.points))
        with np.errstate(invalid="ignore"):
            inside = (pixel > -0.5).all(1) & (pixel < np.array([camera.width, camera.height]) - 0.5).all(1)
        seen = np.flatnonzero((depth > 0) & inside)
        eye = invert_rigid(T_camera_table)[:3, 3].astype(np.float32)
        open_ray = np.zeros(len(self.points), np.float32)
        open_ray[seen] = 1 - self._hidden(self.points[seen], eye)
        return open_ray

    def _hidden(self, points: np.ndarray, eye: np.ndarray) -> np.ndarray:
        """The chance that anything known stands between points (N, 3) and the eye (3,): (N,) in 0..1."""
        step = (eye - points) / self.spacing
        length = np.linalg.norm(step, axis=1, keepdims=True)
        step /= np.maximum(length, 1e-6)
        place = (points - self.origin.astype(np.float32)) / np.float32(self.spacing) + np.float32(
            NEAREST
        ) * step
        shape = np.array(self.known.shape)
        passing = np.ones(len(points), np.float32)
        rows = np.arange(len(points))
        while len(rows):
            node = np.rint(place).astype(np.int32)
            kept = ((node >= 0) & (node < shape)).all(1)  # a ray that has left the lattice never comes back
            rows, place, step, node = rows[kept], place[kept], step[kept], node[kept]
            passing[rows] *= 1 - self.known[tuple(node.T)]
            place = place + step
        return 1 - passing


def next_view(
    reconstruction: Reconstruction | StoredResult,
    poses: np.ndarray | Sequence[np.ndarray],
    camera: Camera | None = None,
) -> NextView:
    """What each of some camera poses is expected to take away of p(uncertain).

    poses: (P, 4, 4) T_world_camera [m], OpenCV axes. camera: whose K and image size the view has; the one of
    the (first) frame by default. Raises ConfigError when there is no pose.
    """
    poses = np.asarray(poses, float)
    if poses.ndim != 3 or poses.shape[1:] != (4, 4) or not len(poses):
        raise ConfigError(f"poses must be (P, 4, 4) with P >= 1, got shape {poses.shape}")
    model, taken, floor = _parts(reconstruction)
    camera = camera or taken[0]
    T_table_world = invert_rigid(reconstruction.T_world_table)
    boxes = []
    for item in reconstruction.objects:
        local = transform(T_table_world, np.asarray(item.mesh.vertices))
        boxes.append((local.min(0), local.max(0)))
    space = UncertainSpace.of(model, boxes, floor)
    for view in taken:
        space = space.seen_by(view, invert_rigid(view.T_world_camera) @ reconstruction.T_world_table)
    gains = [space.gain(camera, invert_rigid(pose) @ reconstruction.T_world_table) for pose in poses]
    return NextView(poses, np.array(gains))


def _parts(reconstruction: Reconstruction | StoredResult) -> tuple[ContraMap, list[Camera], float | None]:
    """The map, the cameras of its views, and the height of the floor in the table frame."""
    from reconstruction.files.stored import StoredResult

    if isinstance(reconstruction, StoredResult):
        cameras = [frame.camera for frame in reconstruction.frames()]
        return reconstruction.map(), cameras, reconstruction.scene["floor"]
    seen = reconstruction.observation
    frames = [view.frame for view in seen.views] if isinstance(seen, JointObservation) else []
    cameras = [frame.camera for frame in frames or [reconstruction.frame]]
    return reconstruction.map, cameras, reconstruction.floor


def poses_around(reconstruction: Reconstruction | StoredResult, count: int) -> np.ndarray:
    """(count, 4, 4) T_world_camera all around the objects, as far from their middle as the frame's camera and
    as high above it, the first one where that camera is."""
    T = _parts(reconstruction)[1][0].T_world_camera
    T_table_world = invert_rigid(reconstruction.T_world_table)
    corners = np.array([item.mesh.bounds for item in reconstruction.objects])
    middle = transform(T_table_world, (corners[:, 0].min(0) + corners[:, 1].max(0)) / 2)
    local = T_table_world @ T
    poses = []
    for angle in 2 * np.pi * np.arange(count) / count:
        turn = np.eye(4)
        turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        there, back = np.eye(4), np.eye(4)
        there[:2, 3], back[:2, 3] = middle[:2], -middle[:2]
        poses.append(reconstruction.T_world_table @ there @ turn @ back @ local)
    return np.array(poses)
