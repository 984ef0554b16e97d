"""The public names in one place: `import contramap`, then `contramap.reconstruct(contramap.load_frame(...))`.

Knows where each name lives and nothing else; each is imported when it is first asked for.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mapping import ConfigError, ContraMap, ContraMapError, DataError, FrameError, MapConfig, load_map
    from perception import Camera, Frame, load_frame, load_images, save_frame
    from reconstruction import (
        PipelineConfig,
        Reconstruction,
        load_result,
        next_view,
        preset,
        reconstruct,
        save_reconstruction,
    )

_HOME = {
    "Camera": "perception",
    "ConfigError": "mapping",
    "ContraMap": "mapping",
    "ContraMapError": "mapping",
    "DataError": "mapping",
    "Frame": "perception",
    "FrameError": "mapping",
    "MapConfig": "mapping",
    "PipelineConfig": "reconstruction",
    "Reconstruction": "reconstruction",
    "load_frame": "perception",
    "load_images": "perception",
    "load_map": "mapping",
    "load_result": "reconstruction",
    "next_view": "reconstruction",
    "preset": "reconstruction",
    "reconstruct": "reconstruction",
    "save_frame": "perception",
    "save_reconstruction": "reconstruction",
}

__all__ = [
    "Camera",
    "ConfigError",
    "ContraMap",
    "ContraMapError",
    "DataError",
    "Frame",
    "FrameError",
    "MapConfig",
    "PipelineConfig",
    "Reconstruction",
    "load_frame",
    "load_images",
    "load_map",
    "load_result",
    "next_view",
    "preset",
    "reconstruct",
    "save_frame",
    "save_reconstruction",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from mapping.version import version

        return version()
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'contramap' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
