"""The small scene that ships with the package, so that the demo runs where the simulator cannot.

Knows how to make it (`python -m sim_scenes.shipped_scene`, needs pybullet) and to unpack it (needs nothing).
All in it is ours: procedural objects, ray-cast by our renderer. Knows nothing of mapping a frame.
"""

from __future__ import annotations

import sys
import tempfile
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mapping.errors import DataError
from mapping.files import temporary_beside

if TYPE_CHECKING:
    from sim_scenes.objects.object_model import ObjectModel

SHIPPED = Path(__file__).with_name("shipped_scene.zip")
FAMILIES = ("box", "can", "bottle", "mug", "fruit", "banana", "blocks", "bowl")
"""Families of objects on the table; meshes that come with other packages are not among them."""
SEED = 3
IMAGE_SCALE = 0.5
"""Pixels along each side, as a share of the simulated camera's 640 x 480."""
FACES = 1500
"""Triangles kept of each true mesh."""


def unpack(folder: Path) -> Path:
    """Write the shipped scene into `folder`, a scene folder as `contramap scenes` makes them; its path.

    Raises DataError when it cannot be written.
    """
    try:
        with zipfile.ZipFile(SHIPPED) as archive:
            archive.extractall(folder)
    except OSError as error:
        raise DataError(f"{folder}: cannot write the scene ({error.strerror or error})") from error
    return folder


def make(path: Path, seed: int = SEED) -> None:
    """Simulate the scene and pack it; the same seed gives the same bytes."""
    from perception.camera import Camera
    from sim_scenes.dataset import ObjectSource, compose, write_scene
    from sim_scenes.objects import builtin
    from sim_scenes.tabletop import TabletopConfig

    def draw(count: int, rng: np.random.Generator) -> list[ObjectModel]:
        chosen = rng.permutation(FAMILIES)[:count]
        return [builtin.make(family, rng) for family in chosen]

    rng = np.random.default_rng(seed)
    config = TabletopConfig(objects=(6, 7))
    source = ObjectSource("builtin", draw)
    placed, cameras = compose(source, 1, rng, config)
    camera = cameras[0]
    K = camera.K * IMAGE_SCALE
    K[2] = [0, 0, 1]
    width, height = round(camera.width * IMAGE_SCALE), round(camera.height * IMAGE_SCALE)
    small = Camera(K, width, height, camera.T_world_camera)
    settings = {"seed": seed, "objects": "builtin", "views": 1, "sensor_noise": False, "label_noise": False}
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "scene"
        write_scene(scene, placed, [small], source, settings, rng, config)
        for mesh, item in zip(sorted((scene / "meshes").iterdir()), placed, strict=True):
            _lighter(item.model).save(mesh)
        _pack(scene, path)


def _lighter(model: ObjectModel) -> ObjectModel:
    """The model with about FACES triangles: less than half a millimetre from the one that was drawn."""
    import fast_simplification
    import trimesh
    from scipy.spatial import cKDTree

    from sim_scenes.objects.object_model import is_closed

    assert model.vertex_colors is not None  # procedural objects have them
    full = len(model.mesh.faces)
    for count in (FACES, 2 * FACES, 4 * FACES):
        if count < full:
            vertices, faces = fast_simplification.simplify(
                np.asarray(model.mesh.vertices, np.float32), np.asarray(model.mesh.faces), target_count=count
            )
            mesh = trimesh.Trimesh(vertices, faces, process=False)
            if is_closed(mesh):
                nearest = cKDTree(model.mesh.vertices).query(vertices)[1]
                return replace(model, mesh=mesh, vertex_colors=model.vertex_colors[nearest])
    return model


def _pack(folder: Path, path: Path) -> None:
    """A zip of the folder without dates, so that the bytes depend on the content alone."""
    with temporary_beside(path) as partial, zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(folder.rglob("*")):
            if file.is_file():
                info = zipfile.ZipInfo(file.relative_to(folder).as_posix())
                info.compress_type, info.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
                archive.writestr(info, file.read_bytes(), compresslevel=9)


if __name__ == "__main__":
    make(Path(sys.argv[1]) if len(sys.argv) > 1 else SHIPPED)
