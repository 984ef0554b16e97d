"""Contrastive kernel maps: points in R^d to classes and one more class, "uncertain"."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mapping.config import MapConfig
    from mapping.contramap import ContraMap
    from mapping.errors import ConfigError, ContraMapError, DataError, FrameError
    from mapping.model_io import load_map

_HOME = {
    "ContraMap": "mapping.contramap",
    "MapConfig": "mapping.config",
    "load_map": "mapping.model_io",
    "ContraMapError": "mapping.errors",
    "ConfigError": "mapping.errors",
    "DataError": "mapping.errors",
    "FrameError": "mapping.errors",
}

__all__ = ["ConfigError", "ContraMap", "ContraMapError", "DataError", "FrameError", "MapConfig", "load_map"]


def __getattr__(name: str) -> Any:
    # Lazy: the command line reads error classes from here and must not pay for torch.
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'mapping' has no attribute {name!r}")
