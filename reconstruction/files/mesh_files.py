"""Meshes with uncertainty as PLY files, and plain meshes as OBJ files, in metres; and what is read back.

Vertices are written in double precision: world frames may have their origin thousands of kilometres away.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from mapping.errors import ConfigError, DataError
from mapping.files import write_atomically
from reconstruction.pictures.palette import paint, uncertainty_colours

Properties = list[tuple[str, str]]
MORE: Properties = [("red", "u1"), ("green", "u1"), ("blue", "u1"), ("uncertainty", "<f4")]
VERTEX = np.dtype([("x", "<f8"), ("y", "<f8"), ("z", "<f8"), *MORE])
OLDER_VERTEX = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), *MORE])
"""Written by earlier versions; still read."""
FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
PLY_TYPES = {"f8": "double", "f4": "float", "u1": "uchar", "i4": "int"}
OBJ_DECIMALS = 8
"""10 nanometres: no two vertices of a mesh are that near to each other."""


def encode_ply(mesh: trimesh.Trimesh, uncertainty: np.ndarray) -> bytes:
    """Binary little-endian PLY: vertices [m], colours of p(uncertain), and p(uncertain) (V,) itself."""
    vertices = np.empty(len(mesh.vertices), VERTEX)
    for axis, name in enumerate("xyz"):
        vertices[name] = mesh.vertices[:, axis]
    colours = uncertainty_colours(uncertainty)
    for channel, name in enumerate(("red", "green", "blue")):
        vertices[name] = colours[:, channel]
    vertices["uncertainty"] = np.clip(uncertainty, 0, 1)
    faces = np.empty(len(mesh.faces), FACE)
    faces["count"], faces["corners"] = 3, mesh.faces
    return _header(VERTEX, len(vertices), len(faces)).encode() + vertices.tobytes() + faces.tobytes()


def decode_ply(path: Path) -> tuple[trimesh.Trimesh, np.ndarray]:
    """Mesh [m] and p(uncertain) (V,) float32 of a file made by encode_ply.

    Raises DataError when the file is missing, cut short, of another layout or holds NaN.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: cannot read the mesh ({error.strerror}); map the frame again") from error
    end = content.find(b"end_header\n") + len(b"end_header\n")
    header = content[:end].decode("ascii", errors="replace")
    words = [line.split() for line in header.splitlines() if line.startswith("element ")]
    counts = [int(line[2]) for line in words if len(line) == 3 and line[2].isdigit()]
    layouts = (VERTEX, OLDER_VERTEX)
    layout = next((kind for kind in layouts if len(counts) == 2 and header == _header(kind, *counts)), None)
    if layout is None:
        raise DataError(f"{path}: not a mesh of a result folder (another PLY header); map the frame again")
    faces_start = end + counts[0] * layout.itemsize
    size = faces_start + counts[1] * FACE.itemsize
    if len(content) != size:
        raise DataError(f"{path}: {len(content)} bytes instead of {size}, cut short? Map the frame again")
    vertices = np.frombuffer(content, layout, counts[0], end)
    faces = np.frombuffer(content, FACE, counts[1], faces_start)["corners"]
    if len(faces) and not (faces.min() >= 0 and faces.max() < counts[0]):
        raise DataError(f"{path}: faces point to vertices that do not exist; map the frame again")
    points = np.stack([vertices[axis] for axis in "xyz"], axis=1).astype(np.float64)
    if not (np.isfinite(points).all() and np.isfinite(vertices["uncertainty"]).all()):
        raise DataError(f"{path}: vertices hold NaN or infinite values; map the frame again")
    mesh, uncertainty = trimesh.Trimesh(points, faces, process=False), vertices["uncertainty"].copy()
    paint(mesh, uncertainty)
    return mesh, uncertainty


def encode_obj(mesh: trimesh.Trimesh) -> bytes:
    """Wavefront OBJ with positions [m, to 10 nanometres] and triangles only, which every planner reads."""
    line = f"v %.{OBJ_DECIMALS}f %.{OBJ_DECIMALS}f %.{OBJ_DECIMALS}f\n"
    vertices = line * len(mesh.vertices) % tuple(np.asarray(mesh.vertices).ravel().tolist())
    faces = "f %d %d %d\n" * len(mesh.faces) % tuple((np.asarray(mesh.faces) + 1).ravel().tolist())
    return ("# contramap, metres\n" + vertices + faces).encode()


def write_mesh(mesh: trimesh.Trimesh, uncertainty: np.ndarray, path: Path) -> None:
    """Write a mesh [m] with p(uncertain) (V,): .ply keeps uncertainty and colours, .obj the surface alone.

    Raises ConfigError for another ending, DataError when the file cannot be written.
    """
    encoders = {".ply": lambda: encode_ply(mesh, uncertainty), ".obj": lambda: encode_obj(mesh)}
    if path.suffix.lower() not in encoders:
        raise ConfigError(
            f"{path}: a mesh is saved as .ply (with uncertainty and colours) or .obj; mesh.export(path) of "
            "trimesh writes other formats"
        )
    write_atomically(path, encoders[path.suffix.lower()]())


def loads_closed(path: Path) -> bool:
    """Whether another program finds a closed surface with consistent faces and finite vertices in a file.

    trimesh's own readers are asked, which join vertices that are the same: what is closed in memory may be
    open as a file. Raises DataError when nothing can be read.
    """
    try:
        loaded: Any = trimesh.load(io.BytesIO(path.read_bytes()), file_type=path.suffix[1:], force="mesh")
    except (OSError, ValueError, KeyError, IndexError, TypeError) as error:
        raise DataError(f"{path}: cannot be read back after writing ({error}); is the disk full?") from error
    finite = bool(len(loaded.faces)) and bool(np.isfinite(loaded.vertices).all())
    return finite and bool(loaded.is_watertight and loaded.is_winding_consistent)


def _header(layout: np.dtype, vertices: int, faces: int) -> str:
    properties = "".join(
        f"property {PLY_TYPES[layout[name].str[1:]]} {name}\n" for name in layout.names or ()
    )
    return (
        "ply\nformat binary_little_endian 1.0\ncomment contramap, metres, uncertainty = p(uncertain)\n"
        f"element vertex {vertices}\n{properties}"
        f"element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
    )
