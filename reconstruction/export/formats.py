"""The export formats by name, and the writing of some of them as folders that are complete or absent.

Knows which formats there are and how a folder is put in place; each format's own file knows the format.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

from mapping.errors import ConfigError, DataError
from mapping.folders import staged_folder
from mapping.guarded_files import read_json
from reconstruction.export.export_scene import ExportScene
from reconstruction.files.output_folder import entries

STATEMENT = "export.json"
"""What each folder says about itself: frame, unit, quaternion order, files."""


class Format(Protocol):
    """What the module of a format offers."""

    STATEMENT: dict[str, str]
    """Frame, unit and quaternion order of its files, in words."""

    def write(self, scene: ExportScene, folder: Path) -> None:
        """Write the format's files into an empty folder."""


FORMATS: dict[str, str] = {
    "obj": "plain_meshes",
    "glb": "glb",
    "urdf": "urdf",
    "mjcf": "mjcf",
    "usd": "usd",
    "sdf-field": "sdf_field",
    "moveit": "moveit",
    "curobo": "curobo",
    "contact-graspnet": "contact_graspnet",
    "gpd": "gpd",
    "vgn": "vgn",
}
"""Name -> module of this package. A new format is a module with STATEMENT and write(), and a line here. One
that writes bodies for physics has GAP, too: what it needs between parts of different objects [m]."""


def check_formats(names: Sequence[str]) -> None:
    """Raises ConfigError that lists the valid names when one is unknown or none is given."""
    unknown = [name for name in names if name not in FORMATS]
    if unknown or not names:
        what = (
            f"unknown export format {', '.join(map(repr, unknown))}" if unknown else "no export format given"
        )
        raise ConfigError(f"{what}; valid: {', '.join(FORMATS)}")


def export(
    scene: ExportScene,
    names: Sequence[str],
    out: Path,
    overwrite: bool = False,
    done: Callable[[str], None] = lambda name: None,
) -> list[Path]:
    """Write formats to out/<name>/ each, and return those folders. `done` is called after each format.

    Raises ConfigError for an unknown format or a folder that is there already (unless `overwrite`, which only
    replaces what an export wrote), DataError when writing fails; a folder is complete or absent.
    """
    check_formats(names)
    names = list(dict.fromkeys(names))
    folders = [Path(out).resolve() / name for name in names]
    for folder in folders:
        _check(folder, overwrite)
    for name, folder in zip(names, folders):
        module = _module(name)
        may_replace = (lambda folder=folder: _check(folder, True)) if overwrite else None
        with staged_folder(folder, may_replace, last=STATEMENT) as partial:
            module.write(scene, partial)
            _state(module, name, scene, partial)
        done(name)
    return folders


def _module(name: str) -> Format:
    module: Any = import_module(f"reconstruction.export.{FORMATS[name]}")
    return module


def _check(folder: Path, overwrite: bool) -> None:
    if not folder.exists():
        return
    if folder.is_dir() and not any(folder.iterdir()):
        return
    if not overwrite:
        raise ConfigError(f"{folder} is there already; choose another --out or pass --overwrite")
    try:
        listed = read_json(folder / STATEMENT)["files"]
        own = {STATEMENT, *map(str, listed)}
    except (DataError, KeyError, TypeError) as error:
        raise ConfigError(
            f"{folder} was not written by an export, so it is not overwritten; choose another --out"
        ) from error
    foreign = [entry.name for entry in entries(folder) if entry.name + "/" * entry.is_dir() not in own]
    if foreign:
        raise ConfigError(
            f"{folder} also holds {foreign[0]}, not of the export, so it is not overwritten; move it away or "
            "choose another --out"
        )


def _state(module: Format, name: str, scene: ExportScene, folder: Path) -> None:
    statement = {
        "format": name,
        **module.STATEMENT,
        "up": scene.up.round(9).tolist(),
        "objects": {item.key: {"label": item.label, "name": item.name} for item in scene.objects},
        **_bodies(module, scene),
        "files": sorted(path.name + "/" * path.is_dir() for path in folder.iterdir()),
    }
    (folder / STATEMENT).write_text(json.dumps(statement, indent=1) + "\n", encoding="utf-8")


def _bodies(module: Format, scene: ExportScene) -> dict[str, Any]:
    """What a format for physics says of its convex parts, and of unseen supports where there are any."""
    gap: float | None = getattr(module, "GAP", None)
    if gap is None:
        return {}
    bodies = scene.bodies(gap)
    unseen = bodies.unseen_statement()
    return {
        "gap_mm": round(1e3 * gap, 3),
        "collision": bodies.collision_statement(),
        **({"unseen_supports": unseen} if unseen else {}),
    }
