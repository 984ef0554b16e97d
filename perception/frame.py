"""One RGB-D frame with optional instance labels: the input of the pipeline. Knows nothing of files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field

import numpy as np

from mapping.errors import FrameError
from perception.camera import Camera
from perception.checks.depth_values import without_sentinels
from perception.checks.intrinsics import check_intrinsics

PLAUSIBLE_DEPTH = (0.05, 20.0)
"""Median depth [m] outside this range means that the unit is wrong."""
FARTHEST = 1e4
"""Depth [m] beyond this is no measurement, but bytes read as one."""


@dataclass(frozen=True)
class Frame:
    """A validated RGB-D frame.

    depth: (H, W) float32 [m] along the camera's z axis, NaN where nothing was measured.
    camera: intrinsics and pose, same image size.
    rgb: (H, W, 3) uint8 or None. labels: (H, W) uint16 instance labels, 0 = background, or None.
    names: label -> object name. source: where the frame came from, for messages and scene.json.
    notes: what was found odd and what was done about it, one line each. trust: what the source vouches for
    ("unit", "kind", "K", "pose"), so that it is noted at most, never refused.
    Raises FrameError when sizes or types differ, depth is empty, its unit is implausible, or K is another
    image's.
    """

    depth: np.ndarray
    camera: Camera
    rgb: np.ndarray | None = None
    labels: np.ndarray | None = None
    names: dict[int, str] = field(default_factory=dict)
    source: str = "memory"
    notes: tuple[str, ...] = ()
    trust: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        shape = (self.camera.height, self.camera.width)
        depth = np.asarray(self.depth)
        if depth.shape != shape or not np.issubdtype(depth.dtype, np.floating):
            raise FrameError(
                f"{self.source}: depth must be a float array in metres of the camera's size {shape}, "
                f"got {depth.dtype} {depth.shape}"
            )
        depth = depth.astype(np.float32)  # a copy: the caller's array stays as it was
        depth[~((depth > 0) & (depth < FARTHEST))] = np.nan
        depth, found = without_sentinels(depth)
        found += check_intrinsics(self.camera, self.source, "K" in self.trust)
        if found:
            object.__setattr__(self, "notes", (*self.notes, *found))
        measured = depth[np.isfinite(depth)]
        if measured.size == 0:
            raise FrameError(f"{self.source}: depth is empty (all pixels are 0, negative or NaN)")
        median = float(np.median(measured))
        if not PLAUSIBLE_DEPTH[0] <= median <= PLAUSIBLE_DEPTH[1]:
            guess = (
                "millimetres read as metres" if median > PLAUSIBLE_DEPTH[1] else "metres scaled down twice"
            )
            raise FrameError(
                f"{self.source}: the median depth is {median:.4g} m, outside {PLAUSIBLE_DEPTH[0]}-"
                f"{PLAUSIBLE_DEPTH[1]} m: {guess}? Set depth_scale (metres per stored unit; "
                "0.001 for millimetres)"
            )
        object.__setattr__(self, "depth", depth)
        if self.rgb is not None and (self.rgb.shape != (*shape, 3) or self.rgb.dtype != np.uint8):
            raise FrameError(
                f"{self.source}: rgb must be uint8 of size {(*shape, 3)} like depth, "
                f"got {self.rgb.dtype} {self.rgb.shape}"
            )
        if self.labels is not None:
            labels = np.asarray(self.labels)
            if labels.shape != shape:
                raise FrameError(
                    f"{self.source}: labels must have the size of depth {shape}, got {labels.shape}"
                )
            if not np.issubdtype(labels.dtype, np.integer) or labels.min() < 0 or labels.max() > 65535:
                raise FrameError(
                    f"{self.source}: labels must be integers in 0..65535 (uint16 instance labels), "
                    f"got {labels.dtype}"
                )
            if not labels.any():
                raise FrameError(
                    f"{self.source}: no labelled pixel (labels are all 0); leave labels out to "
                    "segment by depth"
                )
            object.__setattr__(self, "labels", labels.astype(np.uint16))

    @classmethod
    def from_arrays(
        cls,
        depth: np.ndarray,
        K: np.ndarray | Sequence[float],
        masks: np.ndarray | Sequence[np.ndarray] | Mapping[int | str, np.ndarray] | None = None,
        T_world_camera: np.ndarray | None = None,
        names: Mapping[int, str] | None = None,
        *,
        rgb: np.ndarray | None = None,
        depth_scale: float | None = None,
        trust: Sequence[str] = (),
    ) -> Frame:
        """A frame from arrays in the forms people have them.

        depth: (H, W) float [m], or whole numbers with depth_scale [m per unit]. K: (3, 3), or fx, fy, cx, cy
        [px]. masks: (H, W) labels or one mask, (N, H, W) masks or a list of them (labels 1..N), or label or
        name -> mask. T_world_camera: (4, 4), 7 numbers x y z qx qy qz qw, or {position, orientation}; OpenCV
        axes [m]. names: label -> name. rgb: (H, W, 3) uint8. trust: see Frame. Raises FrameError.
        """
        from perception.inputs.arrays import frame_arguments

        fields = frame_arguments(depth, K, masks, T_world_camera, names, rgb, depth_scale)
        return cls(**fields, trust=tuple(trust))

    def name_of(self, label: int) -> str:
        """The object's name, or `object_<label>` when none was given."""
        return self.names.get(int(label), f"object_{int(label)}")

    def renamed(self, names: Mapping[int, str]) -> Frame:
        """The same frame with these names besides its own; nothing is checked or noted again."""
        frame = copy(self)
        object.__setattr__(frame, "names", {**self.names, **names})
        return frame
