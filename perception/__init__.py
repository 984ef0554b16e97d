"""RGB-D frames and laser logs to clean points, free rays and occluded space.

Costs little more than numpy to import: OpenCV, SciPy, Pillow and Open3D are imported where they are used.
"""

from perception.camera import Camera
from perception.config import PerceptionConfig
from perception.frame import Frame
from perception.frame_io import load_frame, load_images, save_frame
from perception.observation import Observation, ObservedObject, Skipped, SupportPlane
from perception.observe import observe
from perception.space import Region, Space

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
