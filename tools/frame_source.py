"""Where a command's frame comes from: a folder or file, separate files, a bag, or one image of a data set."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mapping.errors import ConfigError
from perception.datasets.bags.config import NO_TOPICS, BagConfig

if TYPE_CHECKING:
    from perception.frame import Frame


@dataclass(frozen=True)
class FrameSource:
    """Where the frame comes from, as the command line says it."""

    frame: Path | None
    rgb: Path | None
    depth: Path | None
    labels: Path | None
    intrinsics: tuple[float, float, float, float] | None
    camera: Path | None
    pose: Path | None
    depth_scale: float | None
    bop: tuple[Path, int, int] | None
    trust: tuple[str, ...]
    at: float | None = None
    topics: BagConfig = NO_TOPICS

    def load(self) -> Frame:
        """The frame; raises ConfigError for options that do not go together, FrameError for bad files."""
        from perception.datasets.bags.opened import is_bag
        from perception.frame_io import load_frame, load_images
        from perception.inputs.camera_file import read_pose_file

        if self.frame is not None and self.depth is not None:
            raise ConfigError(
                f"FRAME ({self.frame}) and --depth were both given, one is wanted; --rgb, --depth and "
                "--labels take one file each, a further word counts as FRAME"
            )
        if sum(item is not None for item in (self.frame, self.depth, self.bop)) != 1:
            raise ConfigError(
                "give either FRAME (a folder, .npz or cloud), --depth with --intrinsics or --camera, or "
                "--bop DIR SCENE IMAGE"
            )
        if self.depth is None and (self.rgb or self.labels or self.intrinsics or self.camera):
            raise ConfigError(
                "--rgb, --labels, --intrinsics and --camera go with --depth, not with FRAME or --bop"
            )
        pose = None if self.pose is None else read_pose_file(self.pose)
        if self.bop is not None:
            from perception.datasets.bop import load_bop

            if pose is not None or self.depth_scale is not None:
                raise ConfigError("--pose and --depth-scale do not go with --bop: the data set has its own")
            return load_bop(*self.bop, trust=self.trust)
        if self.frame is not None and is_bag(self.frame):
            from perception.datasets.bags.bag import load_bag

            if pose is not None or self.depth_scale is not None:
                raise ConfigError("--pose and --depth-scale do not go with a bag: it has its own")
            return load_bag(self.frame, self.at or 0.0, self.topics, self.trust)
        if self.at is not None:
            raise ConfigError(f"--at goes with a bag (.bag, .mcap, .db3, or a folder), not with {self.frame}")
        if self.frame is not None:
            return load_frame(self.frame, depth_scale=self.depth_scale, T_world_camera=pose, trust=self.trust)
        if (self.intrinsics is None) == (self.camera is None):
            raise ConfigError("--depth needs --intrinsics FX FY CX CY or --camera FILE")
        assert self.depth is not None
        return load_images(
            self.rgb,
            self.depth,
            self.labels,
            self.intrinsics or self.camera or (),
            self.depth_scale,
            T_world_camera=pose,
            trust=self.trust,
        )
