"""RGB-D frames and laser logs to clean points, free rays and occluded space.

Names are imported when they are first used: settings can be read without paying for numpy.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from perception.camera import Camera
    from perception.config import PerceptionConfig
    from perception.frame import Frame
    from perception.frame_io import load_frame, load_images, save_frame
    from perception.observation import Observation, ObservedObject, Skipped, SupportPlane
    from perception.observing import observe
    from perception.space import Region, Space

_HOME = {
    "Camera": "perception.camera",
    "Frame": "perception.frame",
    "Observation": "perception.observation",
    "ObservedObject": "perception.observation",
    "PerceptionConfig": "perception.config",
    "Region": "perception.space",
    "Skipped": "perception.observation",
    "Space": "perception.space",
    "SupportPlane": "perception.observation",
    "load_frame": "perception.frame_io",
    "load_images": "perception.frame_io",
    "observe": "perception.observing",
    "save_frame": "perception.frame_io",
}

__all__ = [
    "Camera",
    "Frame",
    "Observation",
    "ObservedObject",
    "PerceptionConfig",
    "Region",
    "Skipped",
    "Space",
    "SupportPlane",
    "load_frame",
    "load_images",
    "observe",
    "save_frame",
]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'perception' has no attribute {name!r}")
