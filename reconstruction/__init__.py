"""From one RGB-D frame to metric meshes with uncertainty, and the files planners read."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from reconstruction.config import PipelineConfig, preset
    from reconstruction.files.result_folder import save_reconstruction
    from reconstruction.files.stored import load_result
    from reconstruction.looking import next_view
    from reconstruction.result import Reconstruction
    from reconstruction.scene import reconstruct

_HOME = {
    "PipelineConfig": "reconstruction.config",
    "Reconstruction": "reconstruction.result",
    "load_result": "reconstruction.files.stored",
    "next_view": "reconstruction.looking",
    "preset": "reconstruction.config",
    "reconstruct": "reconstruction.scene",
    "save_reconstruction": "reconstruction.files.result_folder",
}

__all__ = [
    "PipelineConfig",
    "Reconstruction",
    "load_result",
    "next_view",
    "preset",
    "reconstruct",
    "save_reconstruction",
]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'reconstruction' has no attribute {name!r}")
