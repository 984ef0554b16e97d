"""Meshes with uncertainty as PLY files, and plain meshes as OBJ files, in metres."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from mapping.errors import DataError
from reconstruction.pictures.palette import uncertainty_colours

VERTEX = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
        ("uncertainty", "<f4"),
    ]
)
FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
PLY_TYPES = {"f4": "float", "u1": "uchar", "i4": "int"}


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
    return _header(len(vertices), len(faces)).encode() + vertices.tobytes() + faces.tobytes()


def decode_ply(path: Path) -> tuple[trimesh.Trimesh, np.ndarray]:
    """Mesh [m] and p(uncertain) (V,) float32 of a file made by encode_ply.

    Raises DataError when the file is missing, cut short or of another layout.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: cannot read the mesh ({error.strerror}); map the frame again") from error
    end = content.find(b"end_header\n") + len(b"end_header\n")
    header = content[:end].decode("ascii", errors="replace")
    words = [line.split() for line in header.splitlines() if line.startswith("element ")]
    counts = [int(line[2]) for line in words if len(line) == 3 and line[2].isdigit()]
    if len(counts) != 2 or header != _header(*counts):
        raise DataError(f"{path}: not a mesh of a result folder (another PLY header); map the frame again")
    faces_start = end + counts[0] * VERTEX.itemsize
    size = faces_start + counts[1] * FACE.itemsize
    if len(content) != size:
        raise DataError(f"{path}: {len(content)} bytes instead of {size}, cut short? Map the frame again")
    vertices = np.frombuffer(content, VERTEX, counts[0], end)
    faces = np.frombuffer(content, FACE, counts[1], faces_start)["corners"]
    if len(faces) and not (faces.min() >= 0 and faces.max() < counts[0]):
        raise DataError(f"{path}: faces point to vertices that do not exist; map the frame again")
    points = np.stack([vertices[axis] for axis in "xyz"], axis=1).astype(np.float64)
    return trimesh.Trimesh(points, faces, process=False), vertices["uncertainty"].copy()


def encode_obj(mesh: trimesh.Trimesh) -> bytes:
    """Wavefront OBJ with positions [m, to the micrometre] and triangles only, which every planner reads."""
    vertices = "".join(f"v {x:.6f} {y:.6f} {z:.6f}\n" for x, y, z in mesh.vertices.tolist())
    faces = "".join(f"f {a} {b} {c}\n" for a, b, c in (mesh.faces + 1).tolist())
    return ("# contramap, metres\n" + vertices + faces).encode()


def _header(vertices: int, faces: int) -> str:
    properties = "".join(
        f"property {PLY_TYPES[VERTEX[name].str[1:]]} {name}\n" for name in VERTEX.names or ()
    )
    return (
        "ply\nformat binary_little_endian 1.0\ncomment contramap, metres, uncertainty = p(uncertain)\n"
        f"element vertex {vertices}\n{properties}"
        f"element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
    )
