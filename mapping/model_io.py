"""A fitted map as one .npz file: hinge points, widths, weights and the configuration."""

from __future__ import annotations

import json
import os
import zipfile
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch

from mapping.contramap import ContraMap, MapConfig
from mapping.errors import DataError
from mapping.softmax import FitConfig, FitReport

FORMAT = 1


def save_map(model: ContraMap, path: Path) -> None:
    """Write to a temporary name and rename, so that a full disk leaves no broken file."""
    partial = path.with_name(path.name + ".part")
    try:
        with partial.open("wb") as file:
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
        os.replace(partial, path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise DataError(f"{path}: cannot write the map ({error.strerror})") from error


def load_map(path: str | Path, device: str = "auto") -> ContraMap:
    """Read a map written by ContraMap.save; raises DataError when the file is missing or not a map."""
    path = Path(path)
    try:
        with np.load(path, allow_pickle=False) as stored:
            values = {name: stored[name] for name in stored.files}
        settings = json.loads(str(values["config"]))
        fit = FitConfig(**settings.pop("fit"))
        model = ContraMap(MapConfig(**{**settings, "fit": fit, "device": device}))
        model.hinges, model.gamma = values["hinges"], values["gamma"]
        model.W = torch.from_numpy(values["W"]).to(model.device)
        model.offset = torch.from_numpy(values["offset"]).to(model.device)
        losses = values["losses"].tolist()
        model.report = FitReport(losses, max(len(losses) - 1, 0), bool(values["converged"]))
    except FileNotFoundError as error:
        raise DataError(f"{path}: no such map file") from error
    except (OSError, KeyError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise DataError(f"{path}: not a readable map file ({error}); make it with ContraMap.save") from error
    return model
