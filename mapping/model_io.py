"""A fitted map as one .npz file: hinge points, widths, weights and the configuration."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch

from mapping.config import FitConfig, MapConfig
from mapping.contramap import ContraMap
from mapping.errors import ConfigError, DataError
from mapping.files import temporary_beside
from mapping.guarded_files import line, parse_json, read_npz
from mapping.softmax import FitReport

FORMAT = 1
NAMES = ("format", "hinges", "gamma", "W", "offset", "losses", "converged", "config")
"""The arrays of a map file."""


def save_map(model: ContraMap, path: Path) -> None:
    """Write to a temporary name and rename, so that a full disk leaves no broken file."""
    with temporary_beside(path) as partial, partial.open("wb") as file:
        np.savez(
            file,
            format=FORMAT,
            hinges=model.hinges,
            gamma=model.gamma,
            W=model.W.cpu().numpy(),
            offset=model.offset.cpu().numpy(),
            losses=np.array(model.report.losses),
            converged=model.report.converged,
            config=json.dumps(asdict(model.config)),
        )


def load_map(path: str | Path, device: str = "auto") -> ContraMap:
    """Read a map written by ContraMap.save; raises DataError when the file is missing, not a map, of another
    format, or holds arrays that do not fit each other."""
    path = Path(path)
    values = read_npz(path)
    missing = [name for name in NAMES if name not in values]
    if missing:
        raise DataError(
            f"{path}: not a map file (it lacks {', '.join(missing)}); make it with ContraMap.save"
        )
    if values["format"].shape != () or values["format"].dtype.kind not in "iu" or values["format"] != FORMAT:
        raise DataError(
            f"{path}: a map file of format {values['format']}, this version reads format {FORMAT}; "
            "fit and save the map again"
        )
    wrong = _misfit(values)
    if wrong:
        raise DataError(f"{path}: not a map that can be used: {wrong}; save it again with ContraMap.save")
    try:
        settings = parse_json(str(values["config"]))
        fit = FitConfig(**settings.pop("fit"))
        model = ContraMap(MapConfig(**{**settings, "fit": fit, "device": device}))
    except (ConfigError, KeyError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise DataError(
            f"{path}: its settings cannot be read ({line(error)}); save it again with ContraMap.save"
        ) from error
    arrays = (np.ascontiguousarray(values[name], np.float32) for name in ("hinges", "gamma", "W", "offset"))
    model.hinges, model.gamma, W, offset = arrays
    model.W, model.offset = (torch.from_numpy(array).to(model.device) for array in (W, offset))
    losses = values["losses"].tolist()
    model.report = FitReport(losses, max(len(losses) - 1, 0), bool(values["converged"]))
    return model


def _misfit(values: dict[str, np.ndarray]) -> str | None:
    """What is wrong with a map's arrays, None when they fit."""
    count, dimensions = (*values["hinges"].shape, 0, 0)[:2]
    classes = values["offset"].size
    shapes = {
        "hinges": (count, dimensions),
        "gamma": (count,),
        "W": (count, classes),
        "offset": (classes,),
        "losses": (values["losses"].size,),
        "converged": (),
        "config": (),
    }
    for name, shape in shapes.items():
        if values[name].shape != shape or 0 in shape[:1] or (name == "hinges" and dimensions == 0):
            return f"{name} has shape {values[name].shape}"
        kind = values[name].dtype.kind
        if kind not in {"converged": "b", "config": "U"}.get(name, "f"):
            return f"{name} is of type {values[name].dtype}"
        if kind == "f" and not np.isfinite(values[name].astype(np.float32)).all():
            return f"{name} holds NaN or infinite values"
    return None if (values["gamma"] > 0).all() else "gamma holds widths that are not > 0"
