"""From a map file to a map that answers."""

from __future__ import annotations

from pathlib import Path

import torch

from mapping.config import FitConfig, MapConfig
from mapping.contramap import ContraMap
from mapping.errors import ConfigError, DataError
from mapping.guarded_files import line
from mapping.map_file import read_map
from mapping.softmax import FitReport


def load_map(path: str | Path, device: str = "auto") -> ContraMap:
    """Read a map written by ContraMap.save; raises DataError when the file is missing, not a map, of another
    format, or holds arrays that do not fit each other."""
    path = Path(path)
    stored = read_map(path)
    try:
        settings = dict(stored.config)
        fit = FitConfig(**settings.pop("fit"))
        model = ContraMap(MapConfig(**{**settings, "fit": fit, "device": device}))
    except (ConfigError, KeyError, ValueError, TypeError, AttributeError) as error:
        raise DataError(
            f"{path}: its settings cannot be read ({line(error)}); save it again with ContraMap.save"
        ) from error
    model.hinges, model.gamma = stored.hinges, stored.gamma
    model.W, model.offset = (torch.from_numpy(array).to(model.device) for array in (stored.W, stored.offset))
    model.report = FitReport(stored.losses, max(len(stored.losses) - 1, 0), stored.converged)
    return model
