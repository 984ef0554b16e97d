"""The arrays of a map as one .npz file: hinge points, widths, weights and the configuration.

Knows names and shapes of arrays; knows nothing of how they answer.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mapping.errors import DataError
from mapping.files import temporary_beside
from mapping.guarded_files import line, parse_json, read_npz

FORMAT = 1
NAMES = ("format", "hinges", "gamma", "W", "offset", "losses", "converged", "config")
"""The arrays of a map file."""


@dataclass(frozen=True)
class StoredMap:
    """hinges (H, d), gamma (H,), W (H, C), offset (C,): float32; losses: the objective after every step;
    config: nested settings as plain data."""

    hinges: np.ndarray
    gamma: np.ndarray
    W: np.ndarray
    offset: np.ndarray
    losses: list[float]
    converged: bool
    config: dict[str, Any]


def write_map(stored: StoredMap, path: Path) -> None:
    """Write to a temporary name and rename, so that a full disk leaves no broken file."""
    with temporary_beside(path) as partial, partial.open("wb") as file:
        np.savez(
            file,
            format=FORMAT,
            hinges=stored.hinges,
            gamma=stored.gamma,
            W=stored.W,
            offset=stored.offset,
            losses=np.array(stored.losses),
            converged=stored.converged,
            config=json.dumps(stored.config),
        )


def read_map(path: Path) -> StoredMap:
    """Read a map file; raises DataError when it is missing, no map, of another format, or its arrays do not
    fit each other."""
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
        config = parse_json(str(values["config"]))
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path}: its settings cannot be read ({line(error)}); save the map again") from error
    hinges, gamma, W, offset = (
        np.ascontiguousarray(values[name], np.float32) for name in ("hinges", "gamma", "W", "offset")
    )
    converged = bool(values["converged"])
    return StoredMap(hinges, gamma, W, offset, values["losses"].tolist(), converged, config)


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
