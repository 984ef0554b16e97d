"""Objects from any folder of meshes: which files there are, their names, and what can stand on a table.

Knows files and meshes in metres; knows nothing of scenes and physics.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import trimesh

from mapping.errors import ConfigError, DataError
from sim_scenes.objects.object_model import ObjectModel, load_model
from sim_scenes.objects.split import in_part

SUFFIXES = (".ply", ".obj", ".glb")
Y_UP = (".glb",)
"""Formats whose y axis points up by their standard; these objects are turned so that z does."""
SIZES = (0.005, 2.0)
"""Longest side [m] of what can be an object on a table; beyond these a file is hardly in metres."""
SOURCE = "folder"


@dataclass(frozen=True)
class FolderConfig:
    """Which objects of a folder are drawn."""

    part: str = "all"
    """all, train or held-out: by the objects' names, so that what was learned from is never judged on."""
    only: Path | None = None
    """Text file that names the objects to draw, one a line; by default all."""
    max_size: float | None = None
    """Longest side allowed [m]."""


@dataclass
class MeshFolder:
    """A folder of meshes to draw from. `refused` says why objects were passed over, as far as was looked."""

    folder: Path
    config: FolderConfig
    files: dict[str, Path]
    refused: dict[str, str] = field(default_factory=dict)

    @classmethod
    def open(cls, folder: Path, config: FolderConfig | None = None) -> MeshFolder:
        """List the meshes below `folder`.

        Raises DataError when there are none, ConfigError for senseless settings.
        """
        config = config or FolderConfig()
        if config.max_size is not None and not config.max_size > 0:
            raise ConfigError(f"max_size must be a length above 0 [m], got {config.max_size}")
        every = mesh_files(folder)
        if not every:
            raise DataError(
                f"{folder}: no meshes found; expected files ({', '.join(SUFFIXES)}) in metres, z up"
            )
        wanted = _names_in(config.only, every) if config.only else set(every)
        files = {name: path for name, path in every.items() if name in wanted and in_part(name, config.part)}
        if not files:
            raise DataError(f"{folder}: none of its {len(every)} meshes is in part {config.part!r}")
        return cls(folder.resolve(), config, files)

    def draw(self, count: int, rng: np.random.Generator) -> list[ObjectModel]:
        """`count` different objects; fewer when the folder has no more that are fit.

        Raises DataError when none is fit, with the reasons.
        """
        names = list(self.files)
        chosen: list[ObjectModel] = []
        for index in rng.permutation(len(names)):
            model = self.load(names[index])
            if model is not None:
                chosen.append(model)
            if len(chosen) == count:
                break
        if not chosen:
            reasons = Counter(reason.split(":")[0] for reason in self.refused.values())
            listed = "; ".join(f"{number} {reason}" for reason, number in reasons.most_common(4))
            raise DataError(f"{self.folder}: no mesh can be put on a table: {listed}")
        return chosen

    def load(self, name: str) -> ObjectModel | None:
        """One object, z up; None where it is not fit, with the reason in `refused`."""
        if name in self.refused:
            return None
        try:
            model = _load(self.files[name], name)
        except DataError as error:
            self.refused[name] = f"cannot be read: {error}"
            return None
        reason = _reason_against(model, self.config.max_size)
        if reason is not None:
            self.refused[name] = reason
            return None
        return model

    def record(self) -> dict[str, object]:
        """What decides which objects are drawn, as plain values."""
        return {
            "folder": str(self.folder),
            "part": self.config.part,
            "only": sorted(self.files) if self.config.only else None,
            "max_size": self.config.max_size,
        }


def mesh_files(folder: Path) -> dict[str, Path]:
    """Name -> file of all meshes below a folder, in the order of their paths.

    A name is the file's own, led by those of its folders where that alone is not unique.
    """
    if not folder.is_dir():
        raise DataError(f"{folder}: no such folder of meshes")
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file())
    stems = Counter(path.stem for path in paths)
    named: dict[str, Path] = {}
    for path in paths:
        whole = path.relative_to(folder).with_suffix("")
        name = path.stem if stems[path.stem] == 1 else "__".join(whole.parts)
        while name in named:  # one object in two formats
            name += path.suffix.replace(".", "_").lower()
        named[name] = path
    return named


def _names_in(listing: Path, known: dict[str, Path]) -> set[str]:
    try:
        lines = listing.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{listing}: cannot be read as a text file of object names ({error})") from error
    names = {line.strip() for line in lines if line.strip() and not line.startswith("#")}
    if missing := sorted(names - set(known)):
        raise ConfigError(
            f"{listing}: {missing[0]!r} is no object of the folder ({len(missing)} such names); "
            f"it has {', '.join(list(known)[:5])} ..."
        )
    return names


def _reason_against(model: ObjectModel, max_size: float | None) -> str | None:
    longest = float(model.mesh.extents.max())
    if not SIZES[0] <= longest <= SIZES[1]:
        return f"not of household size: {longest:.4g} m long (are its units metres?)"
    if max_size is not None and longest > max_size:
        return f"longer than {max_size:g} m: {longest:.3f} m"
    if not model.watertight or model.mesh.volume <= 0:
        return "not watertight: its inside is not defined"
    return None


@lru_cache(maxsize=1024)
def _load(path: Path, name: str) -> ObjectModel:
    model = load_model(path, name, SOURCE)
    if not np.isfinite(model.mesh.vertices).all():
        raise DataError(f"{path}: holds coordinates that are no numbers")
    if path.suffix.lower() not in Y_UP:
        return model
    x, y, z = np.asarray(model.mesh.vertices).T
    turned = trimesh.Trimesh(np.stack([x, -z, y], axis=1), model.mesh.faces, process=False)
    return replace(model, mesh=turned)
