"""A scene with truth as cameras that stand elsewhere see it: straight above it, or turned so far aside that
the image's border cuts an object.

Knows the truth and the renderer; knows nothing of maps.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np

from mapping.errors import DataError
from perception.camera import Camera, look_at
from perception.frame import Frame
from sim_scenes.objects.object_model import load_model
from sim_scenes.render import Renderer
from sim_scenes.surroundings import Surroundings
from sim_scenes.tabletop import PlacedObject, TabletopConfig
from sim_scenes.truth import Truth

Side = Literal["left", "right", "top", "bottom"]
SIDES: tuple[Side, ...] = get_args(Side)
ABOVE = 0.8
"""A camera straight above hangs at least this high over the table [m]; higher where not all would fit."""
MARGIN = 12
"""All objects lie this far within its image [px]."""


class OtherViews:
    """The objects of one scene on a plain table, ready to be seen by other cameras."""

    def __init__(self, truth: Truth) -> None:
        self.truth = truth
        models = [load_model(item.mesh_path, item.name, item.source, item.scale) for item in truth.objects]
        placed = [PlacedObject(model, item.T_world_object) for model, item in zip(models, truth.objects)]
        self._renderer = Renderer(placed, Surroundings.plain(TabletopConfig().table_size_m))
        self._labels = np.array([0, *(item.label for item in truth.objects)], np.uint16)
        self._names = {item.label: item.name for item in truth.objects}

    def seen_by(self, camera: Camera) -> Frame:
        """Depth without noise, and labels, as a camera has them."""
        depth, number = self._renderer.depth_and_labels(camera)
        return Frame(depth, camera, None, self._labels[number], self._names, "simulated")

    def from_above(self, like: Camera) -> Frame:
        """The frame of a camera straight above the middle of all objects, with the lens of another."""
        corners = np.concatenate([mesh.bounds for mesh in self.truth.meshes.values()])  # (2 K, 3)
        middle = (corners.min(0) + corners.max(0)) / 2
        # All that lies at height z fits in where it lies within (height - z) * fits of the middle.
        fits = (np.array([like.width, like.height]) / 2 - MARGIN) / like.K[[0, 1], [0, 1]]
        height = max(ABOVE, float((corners[:, 2:] + np.abs(corners - middle)[:, :2] / fits).max()))
        eye = np.array([middle[0], middle[1], height])
        K = like.K.copy()
        K[:2, 2] = (like.width - 1) / 2, (like.height - 1) / 2
        return self.seen_by(Camera(K, like.width, like.height, look_at(eye, eye - [0, 0, 1], up=(0, 1, 0))))

    def cut(self, frame: Frame, label: int, share: float, side: Side) -> Frame:
        """The frame of the same camera, turned in place until `share` of a label's pixels lie beyond a side
        of the image."""
        assert frame.labels is not None
        rays = frame.camera.rays[frame.labels == label].astype(np.float64)
        if len(rays) == 0:
            raise DataError(f"label {label} does not show: nothing to cut")
        camera = frame.camera
        along = 0 if side in ("left", "right") else 1
        far = side in ("right", "bottom")
        last = ((camera.width, camera.height)[along] - 0.5) if far else -0.5
        border = np.arctan((last - camera.K[along, 2]) / camera.K[along, along])
        angles = np.arctan2(rays[:, along], rays[:, 2])
        turn = np.quantile(angles, 1 - share if far else share) - border
        T = np.eye(4)
        T[:3, :3] = _turn(along, float(turn))
        return self.seen_by(Camera(camera.K, camera.width, camera.height, camera.T_world_camera @ T))


def shown(frame: Frame, label: int, camera: Camera) -> float:
    """Share of the rays to a label's pixels that a turned camera in the same place has in its image too."""
    assert frame.labels is not None
    rays = frame.camera.rays[frame.labels == label].astype(np.float64)
    R = camera.T_world_camera[:3, :3].T @ frame.camera.T_world_camera[:3, :3]
    return float(inside_image(camera, rays @ R.T).mean()) if len(rays) else 0.0


def inside_image(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Which points (N, 3) in the camera frame its image holds: (N,) bool."""
    pixel, z = camera.project(points)
    with np.errstate(invalid="ignore"):
        return np.asarray((z > 0) & ((pixel >= -0.5) & (pixel < _size(camera) - 0.5)).all(1))


def whole(frame: Frame, labels: Sequence[int], margin: int = 2) -> list[int]:
    """Those labels that keep `margin` pixels from the image's border."""
    assert frame.labels is not None
    within = frame.labels[margin:-margin, margin:-margin]
    return [label for label in labels if (frame.labels == label).sum() == (within == label).sum() > 0]


def _size(camera: Camera) -> np.ndarray:
    return np.array([camera.width, camera.height])


def _turn(along: int, angle: float) -> np.ndarray:
    """Rotation (3, 3) that turns the line of sight by an angle to the right (along 0) or down (1)."""
    c, s = np.cos(angle), np.sin(angle)
    if along == 0:
        return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return np.array([[1, 0, 0], [0, c, s], [0, -s, c]])
