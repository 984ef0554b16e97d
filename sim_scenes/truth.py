"""The truth of a scene folder: which objects stand where. Read by tests, the demo and the evaluation."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import trimesh

from mapping.errors import DataError
from sim_scenes.objects.object_model import load_model
from sim_scenes.objects.ycb import find_ycb

TRUTH_FILE = "truth.json"


@dataclass(frozen=True)
class TrueObject:
    """One object of a scene.

    label: its value in labels.png. mesh_path: the mesh in its own frame; scale: file units to metres.
    T_world_object: (4, 4). watertight: whether the mesh bounds a volume.
    """

    label: int
    name: str
    source: str
    mesh_path: Path
    scale: float
    T_world_object: np.ndarray
    watertight: bool


@dataclass(frozen=True)
class Truth:
    """All objects of a scene and its support plane.

    plane: (4,) a, b, c, d with a x + b y + c z + d = 0 in the world frame, unit normal towards the objects.
    views: frame folders of this scene, the scene folder itself first. seed: what the scene was made from.
    """

    folder: Path
    objects: tuple[TrueObject, ...]
    plane: np.ndarray
    views: tuple[Path, ...]
    seed: int

    @cached_property
    def meshes(self) -> dict[int, trimesh.Trimesh]:
        """Label -> true mesh [m] in the world frame."""
        found = {}
        for item in self.objects:
            mesh = load_model(item.mesh_path, item.name, item.source, item.scale).mesh.copy()
            mesh.apply_transform(item.T_world_object)
            found[item.label] = mesh
        return found


def load_truth(folder: str | Path, ycb_dir: str | Path | None = None) -> Truth:
    """Read a scene folder's truth.json.

    YCB meshes are looked for in `ycb_dir`, where they were when the scene was made, and where find_ycb looks.
    Raises DataError when the file is missing or broken, or a mesh cannot be found.
    """
    folder = Path(folder)
    path = folder / TRUTH_FILE
    if not path.is_file():
        raise DataError(f"{folder}: no {TRUTH_FILE}; `contramap scenes OUT` makes scenes that have one")
    try:
        content = json.loads(path.read_text())
        objects = tuple(_object(item, folder, content, ycb_dir) for item in content["objects"])
        return Truth(
            folder=folder,
            objects=objects,
            plane=np.array(content["support_plane"], float),
            views=tuple(folder / view for view in content["views"]),
            seed=int(content["seed"]),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"{path}: broken truth file ({error!r}); make the scene again") from error


def _object(item: dict, folder: Path, content: dict, ycb_dir: str | Path | None) -> TrueObject:
    relative = Path(item["mesh"])
    roots: list[Path | None] = [folder]
    if item["source"] == "ycb":
        recorded = content.get("ycb_dir")
        roots = [Path(ycb_dir)] if ycb_dir else [Path(recorded) if recorded else None, find_ycb()]
    mesh_path = next((root / relative for root in roots if root and (root / relative).is_file()), None)
    if mesh_path is None:
        raise DataError(
            f"{folder}: mesh {relative} of {item['name']} not found; name the YCB folder (--ycb, YCB_DIR)"
        )
    T = np.array(item["T_world_object"], float)
    if T.shape != (4, 4):
        raise ValueError(f"T_world_object of {item['name']} must be 4x4")
    return TrueObject(
        int(item["label"]),
        item["name"],
        item["source"],
        mesh_path,
        float(item["scale"]),
        T,
        bool(item["watertight"]),
    )
