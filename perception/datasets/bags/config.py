"""Which topics of a bag are read. Knows settings only."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class BagConfig:
    """Topics and frames of a bag; what is None is found by type where only one fits."""

    depth: str | None = None
    """Depth image aligned to colour: 16UC1 [mm] or 32FC1 [m], or their compressedDepth."""
    colour: str | None = None
    """Colour image of the same size."""
    info: str | None = None
    """CameraInfo of the depth image."""
    labels: str | None = None
    """Instance labels of the same size, 0 = background: mono16, 32SC1 or mono8. Without them the depth is
    segmented."""
    fixed_frame: str | None = None
    """The tf frame that meshes are given in; by default the root of the tree that the camera is in. The
    camera's own frame: it stands still, and no tf is needed."""
    every: float = 0.0
    """Of a stream of frames, take one in so many seconds; 0: all [s]."""


NO_TOPICS = BagConfig()
"""All topics are found by type."""
