"""Small scene folders with truth, made without physics, for the tests of the evaluation."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import trimesh
from conftest import Shape, make_tabletop, shape_mesh

from perception.frame_io import save_frame

SHAPES = (
    (
        Shape("box", (0.06, 0.10, 0.08), (0.06, 0.10, 0.04), 0.4),
        Shape("sphere", (0.04,), (-0.02, -0.06, 0.04)),
    ),
    (
        Shape("cylinder", (0.035, 0.10), (-0.05, 0.06, 0.05)),
        Shape("box", (0.08, 0.05, 0.05), (0.05, -0.08, 0.025), 0.7),
    ),
)


def write_scenes(folder: Path) -> Path:
    """Two scenes of two solids each, 240x180, named scene_0000 and scene_0001."""
    for number, shapes in enumerate(SHAPES):
        write_scene(folder / f"scene_{number:04d}", shapes)
    return folder


def write_scene(folder: Path, shapes: tuple[Shape, ...]) -> None:
    """A frame folder with truth.json; the meshes lie in the world frame."""
    save_frame(make_tabletop(shapes, size=(240, 180)).frame, folder, 1e-4)
    objects = []
    for label, shape in enumerate(shapes, start=1):
        legacy = shape_mesh(shape)
        mesh = trimesh.Trimesh(np.asarray(legacy.vertices), np.asarray(legacy.triangles))
        mesh.export(folder / f"{label}.ply")
        objects.append(
            {
                "label": label,
                "name": f"{shape.kind}_{label}",
                "source": "builtin",
                "mesh": f"{label}.ply",
                "scale": 1.0,
                "T_world_object": np.eye(4).tolist(),
                "watertight": True,
            }
        )
    truth = {"seed": 0, "support_plane": [0, 0, 1, 0], "views": ["."], "ycb_dir": None, "objects": objects}
    (folder / "truth.json").write_text(json.dumps(truth))
