"""Where a scene's objects come from: scans, built-in shapes, figures of blocks, or any folder of meshes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mapping.errors import ConfigError, DataError
from sim_scenes.objects import builtin, random_urdfs, ycb
from sim_scenes.objects.mesh_folder import FolderConfig, MeshFolder
from sim_scenes.objects.object_model import ObjectModel

WORDS = ("auto", "ycb", "builtin", "figures")


@dataclass(frozen=True)
class ObjectSource:
    """A set of objects to draw from.

    draw(count, rng) gives models; ycb_dir: where scans came from; folder: the folder of meshes, if it is one.
    """

    kind: str
    draw: Callable[[int, np.random.Generator], list[ObjectModel]]
    ycb_dir: Path | None = None
    folder: MeshFolder | None = None


def object_source(
    objects: str = "auto", ycb_dir: str | Path | None = None, config: FolderConfig | None = None
) -> ObjectSource:
    """Objects to put on tables: "ycb" scans, "builtin" shapes, "figures" of blocks (they ship with pybullet;
    no training set holds them), "auto": scans if found, else built-in; or a folder of meshes (metres, z up).

    config: which of the folder's objects. Raises ConfigError for another word, or settings that only folders
    know, and DataError when scans are asked for and not found.
    """
    if objects not in WORDS:
        if not Path(objects).expanduser().is_dir():
            raise ConfigError(
                f"objects: {objects!r} is neither a folder of meshes nor one of {', '.join(WORDS)}"
            )
        folder = MeshFolder.open(Path(objects).expanduser(), config)
        return ObjectSource("folder", folder.draw, folder=folder)
    if config is not None and config != FolderConfig():
        raise ConfigError(f"part, only and max_size choose from a folder of meshes; objects is {objects!r}")
    if objects == "figures":
        return ObjectSource("figures", random_urdfs.draw)
    scans = None if objects == "builtin" else ycb.find_ycb(ycb_dir)
    if scans is None and objects == "ycb":
        raise DataError(
            "no YCB scans found; name their folder with --ycb DIR or YCB_DIR, download them with "
            "`contramap fetch ycb`, or use --objects builtin"
        )
    if scans is None:
        return ObjectSource("builtin", builtin.draw)
    return ObjectSource("ycb", _connected_scans(scans), scans)


def _connected_scans(folder: Path) -> Callable[[int, np.random.Generator], list[ObjectModel]]:
    names = ycb.list_models(folder)

    def draw(count: int, rng: np.random.Generator) -> list[ObjectModel]:
        chosen: list[ObjectModel] = []
        for index in rng.permutation(len(names)):
            model = ycb.load_ycb(folder, names[index])
            if model.connected:  # transparent bottles were scanned in pieces
                chosen.append(model)
            if len(chosen) == count:
                break
        return chosen

    return draw
