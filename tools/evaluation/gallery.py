"""The paper's gallery, scene by scene: what the camera saw, each method's meshes and uncertainty slices."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from mapping.files import temporary_beside
from perception.camera import Camera
from reconstruction.pictures.palette import object_colour, uncertainty_colours
from reconstruction.pictures.shading import ShadingConfig, render
from tools.evaluation.answers import DeliveredMeshes, delivered_meshes
from tools.evaluation.case import Case, load_case
from tools.evaluation.fitted_map import FittedMap
from tools.evaluation.methods import method

COLUMNS = 4
"""Pictures side by side: what was seen and one method, then two methods a line."""
WIDTH = 480
"""Width of every picture [px]."""
SLICE_MARGIN = 0.08
"""Space shown around the objects in a slice [m]."""
SEED = 0
"""Seed of the maps that are shown."""


def gallery_pictures(scene: Path, names: tuple[str, ...], ycb_dir: Path | None) -> dict[str, np.ndarray]:
    """Title -> picture (H, W, 3) uint8: colour image, segmented cloud, mesh and slice of each method."""
    case = load_case(scene, ycb_dir)
    camera = _small(case)
    pictures = {"RGB": _resized(_rgb(case), camera), "segmented cloud": _resized(_labels(case), camera)}
    for name in names:
        fitted = method(name).fit(case.view, case.rng(SEED, "fit"))
        meshes = delivered_meshes(fitted, case)
        pictures[f"{name}: meshes"] = _shaded(case, camera, meshes)
        pictures[f"{name}: uncertainty slice"] = _slice(case, fitted, meshes, camera)
    return pictures


def pictures_of(task: tuple[Path, tuple[str, ...], Path | None]) -> dict[str, np.ndarray]:
    """gallery_pictures of a task: scene, names of methods, folder of scans."""
    return gallery_pictures(*task)


def write_gallery(rows: dict[str, dict[str, np.ndarray]], path: Path) -> None:
    """One picture of all scenes, COLUMNS pictures side by side; each scene begins a line."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    pictures = [item for scene in rows.values() for item in _filled_up(list(scene.items()))]
    lines = -(-len(pictures) // COLUMNS)
    ratio = max(picture.shape[0] / picture.shape[1] for _, picture in pictures if picture is not None)
    figure, axes = plt.subplots(
        lines,
        COLUMNS,
        figsize=(2.6 * COLUMNS, (2.6 * ratio + 0.25) * lines),
        dpi=130,
        squeeze=False,
        gridspec_kw={"wspace": 0.02, "hspace": 0.02},
        layout="constrained",
    )
    for cell, (title, picture) in zip(axes.flat, pictures):
        cell.set_axis_off()
        if picture is not None:
            cell.imshow(picture)
            cell.set_title(title, fontsize=8)
    with temporary_beside(path) as partial:
        figure.savefig(partial, format="png")
    plt.close(figure)


def _filled_up(scene: list[tuple[str, np.ndarray]]) -> list[tuple[str, np.ndarray | None]]:
    """A scene's pictures by title, and empty places to the end of the line."""
    return [*scene, *[("", None)] * (-len(scene) % COLUMNS)]


def _small(case: Case) -> Camera:
    """The frame's camera in the table frame, at the gallery's size."""
    camera = case.frame.camera
    scale = WIDTH / camera.width
    height = round(camera.height * scale)
    K = camera.K * np.array([[scale], [scale], [1.0]])
    return Camera(K, WIDTH, height, case.observation.T_table_camera)


def _resized(picture: np.ndarray, camera: Camera) -> np.ndarray:
    import cv2

    return cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_AREA)


def _rgb(case: Case) -> np.ndarray:
    if case.frame.rgb is not None:
        return case.frame.rgb
    return np.full((*case.frame.depth.shape, 3), 200, np.uint8)


def _labels(case: Case) -> np.ndarray:
    """The measured points in the colours of their objects, the rest of the image faded."""
    grey = _rgb(case).mean(2, keepdims=True)
    picture = np.repeat(200 + 0.2 * (grey - 128), 3, axis=2)
    shade = 0.45 + 0.55 * np.clip(grey / 160, 0.3, 1.15)
    flat, light = picture.reshape(-1, 3), shade.reshape(-1, 1)
    for index, item in enumerate(case.observation.objects):
        flat[item.pixels] = np.array(object_colour(index)) * light[item.pixels]
    return np.clip(picture, 0, 255).astype(np.uint8)


def _shaded(case: Case, camera: Camera, meshes: DeliveredMeshes) -> np.ndarray:
    """Delivered meshes from the camera's viewpoint, in the colours of their objects."""
    if not meshes:
        return np.full((camera.height, camera.width, 3), ShadingConfig().background, np.uint8)
    colours = [
        np.tile(object_colour(case.index_of[label]), (len(surface.mesh.vertices), 1))
        for label, surface in meshes.items()
    ]
    ground = (np.array([0.0, 0.0, 1.0]), 0.0) if case.observation.support is not None else None
    return render([surface.mesh for surface in meshes.values()], colours, camera, ground)


def _slice(
    case: Case,
    fitted: FittedMap,
    meshes: DeliveredMeshes,
    camera: Camera,
) -> np.ndarray:
    """Uncertainty on the horizontal plane through the objects' seen middles; the camera is at the bottom.

    Lines: true outlines white, predicted outlines black.
    """
    seen = np.concatenate([item.points for item in case.observation.objects])
    height = float(np.median([item.points[:, 2].mean() for item in case.observation.objects]))
    low, high = seen.min(0)[:2] - SLICE_MARGIN, seen.max(0)[:2] + SLICE_MARGIN
    step = max((high[0] - low[0]) / camera.height, (high[1] - low[1]) / camera.width)
    middle = (low + high) / 2
    # Picture rows run towards the camera (-x of the table frame), columns to its right (-y).
    x = middle[0] + step * (camera.height / 2 - np.arange(camera.height) - 0.5)
    y = middle[1] + step * (camera.width / 2 - np.arange(camera.width) - 0.5)
    points = np.stack(
        [*np.meshgrid(x[::2], y[::2], indexing="ij"), np.full((len(x[::2]), len(y[::2])), height)], -1
    )
    uncertainty = fitted.predict(points.reshape(-1, 3).astype(np.float32))[1].reshape(points.shape[:2])
    picture = _resized(uncertainty_colours(np.clip(uncertainty, 0, 1)), replace(camera))
    for mesh in case.meshes.values():
        _outline(picture, mesh, height, x[0], y[0], step, (255, 255, 255))
    for surface in meshes.values():
        _outline(picture, surface.mesh, height, x[0], y[0], step, (20, 20, 20))
    return picture


def _outline(
    picture, mesh: trimesh.Trimesh, height: float, x0: float, y0: float, step: float, colour
) -> None:
    """Draw where a mesh crosses the slice."""
    import cv2
    from trimesh.intersections import mesh_plane

    segments = mesh_plane(mesh, np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, height])).reshape(-1, 2, 3)
    pixels = np.stack([(y0 - segments[..., 1]) / step, (x0 - segments[..., 0]) / step], -1)
    cv2.polylines(picture, list(np.rint(pixels).astype(np.int32)), False, colour, 1, cv2.LINE_AA)
