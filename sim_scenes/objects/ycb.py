"""Finds and reads YCB scans in the official layout: `<ID>/google_16k/textured.obj`."""

from __future__ import annotations

import os
from functools import lru_cache
from pathlib import Path

from mapping.errors import DataError
from mapping.files import cache_dir
from sim_scenes.objects.object_model import ObjectModel, load_model

MESH_FILE = Path("google_16k/textured.obj")
REPOSITORY = Path(__file__).resolve().parents[2]


def find_ycb(directory: str | Path | None = None) -> Path | None:
    """The first folder with YCB scans, or None.

    Looked for in: `directory` (DataError if it holds none), $YCB_DIR (likewise), `../shared/data/ycb` from
    the repository and from the current folder, and where `contramap fetch ycb` puts the scans.
    """
    for given, origin in ((directory, "the given folder"), (os.environ.get("YCB_DIR"), "YCB_DIR")):
        if given:
            folder = Path(given).expanduser()
            if not list_models(folder):
                raise DataError(
                    f"{folder} ({origin}): no YCB scans found; expected <ID>/{MESH_FILE} in it "
                    "(`contramap fetch ycb --to DIR` downloads them)"
                )
            return folder
    for folder in (REPOSITORY / "../shared/data/ycb", Path("../shared/data/ycb"), default_ycb_dir()):
        if list_models(folder):
            return folder.resolve()
    return None


def default_ycb_dir() -> Path:
    """Where `contramap fetch ycb` puts the scans when no folder is named."""
    return cache_dir() / "ycb"


def list_models(folder: str | Path) -> list[str]:
    """Sorted IDs of the scans in a YCB folder; empty when there are none or no such folder."""
    return sorted(path.parent.parent.name for path in Path(folder).glob(f"*/{MESH_FILE.as_posix()}"))


def mesh_path(folder: str | Path, model_id: str) -> Path:
    """Path of one scan's mesh; DataError naming some valid IDs when it is not there."""
    path = Path(folder) / model_id / MESH_FILE
    if not path.is_file():
        known = list_models(folder)
        raise DataError(f"{folder}: no YCB scan {model_id!r}; it has {', '.join(known[:8])} ...")
    return path


def load_ycb(folder: str | Path, model_id: str) -> ObjectModel:
    """Read one scan [m] with its texture."""
    return _load(str(Path(folder).resolve()), model_id)


@lru_cache(maxsize=128)
def _load(folder: str, model_id: str) -> ObjectModel:
    return load_model(mesh_path(folder, model_id), model_id, "ycb")
