"""What recordings of a run and of a stream share: stream, table, cameras, meshes, text, the first view.

Knows rerun and results; knows nothing of which entities a recording holds.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh

from mapping.errors import ConfigError
from mapping.files import write_atomically
from perception.camera import invert_rigid, transform
from reconstruction.pictures.blueprint import first_view
from reconstruction.pictures.guides import log_axes, log_colour_bar
from reconstruction.pictures.slices import directions

if TYPE_CHECKING:
    from perception.camera import Camera
    from reconstruction.files.stored import StoredObject
    from reconstruction.result import ReconstructedObject


def rerun_sdk() -> Any:
    """The rerun package. Raises ConfigError when it is not installed."""
    try:
        import rerun
    except ImportError as error:
        raise ConfigError(f"recordings need rerun ({error}): pip install 'contramap[viz]'") from error
    return rerun


def save_stream(stream: Any, memory: Any, path: Path) -> None:
    """Write what a stream has collected in memory, and end it. Raises DataError when writing fails."""
    # Collected in memory: rerun's own file sink neither raises nor returns when the disk is full.
    stream.flush()
    write_atomically(Path(path), memory.drain_as_bytes())
    stream.disconnect()


def log_table(stream: Any, T_world_table: np.ndarray, upright: bool) -> None:
    """The table frame and the world's as arrows, and the colour bar of p(uncertain)."""
    rr = rerun_sdk()
    axes = rr.ViewCoordinates.RIGHT_HAND_Z_UP if upright else rr.ViewCoordinates.RDF
    pose = rr.Transform3D(translation=T_world_table[:3, 3], mat3x3=T_world_table[:3, :3])
    stream.log("world/table", pose, axes, static=True)
    log_axes(stream, "world/axes", "world")
    log_axes(stream, "world/table/axes", "table")
    log_colour_bar(stream)


def pinhole(camera: Camera) -> Any:
    """A camera's image plane, 10 cm before it."""
    return rerun_sdk().Pinhole(
        image_from_camera=camera.K,
        width=camera.width,
        height=camera.height,
        camera_xyz=rerun_sdk().ViewCoordinates.RDF,
        image_plane_distance=0.1,
    )


def mesh3d(
    mesh: trimesh.Trimesh,
    colour: tuple[int, ...] | None = None,
    vertex_colours: np.ndarray | None = None,
) -> Any:
    """A mesh in one colour or with one a vertex."""
    return rerun_sdk().Mesh3D(
        vertex_positions=mesh.vertices,
        triangle_indices=mesh.faces,
        vertex_normals=mesh.vertex_normals,
        vertex_colors=vertex_colours,
        albedo_factor=colour,
    )


def log_text(stream: Any, text: str, static: bool = True) -> None:
    """The summary, as Markdown."""
    rr = rerun_sdk()
    stream.log("summary", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=static)


def view_of(
    objects: Sequence[ReconstructedObject | StoredObject], T_world_table: np.ndarray, upright: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Eye, target and up (3,) of the first view, in the table frame [m]."""
    axes = directions(upright)
    parts = [np.asarray(item.mesh.vertices) for item in objects]
    points = transform(invert_rigid(T_world_table), np.concatenate(parts)) if parts else 0.1 * axes
    return first_view(points.min(0), points.max(0), axes)
