"""The process that cuts meshes into convex parts with CoACD and manifold3d, as asked on stdin.

A process of its own: coacd breaks a later import of open3d in the same process, prints to stdout, may die on
odd meshes, and both hold Python's lock while they work. It imports no more than it needs to cut, and nothing
of whoever started it: a script that exports needs no `if __name__ == "__main__"`.
"""

from __future__ import annotations

import ctypes
import io
import json
import os
import signal
import struct
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np

LENGTH = struct.Struct("<Q")
"""A message is its length and the content of an .npz file."""
Mesh = tuple[np.ndarray, np.ndarray]
"""Vertices (V, 3) [m] and faces (F, 3)."""
PARSING = threading.Lock()
"""numpy reads headers with Python's parser, and that of Python 3.11 may fail when two threads use it at once
("AST constructor recursion depth mismatch")."""
PR_SET_PDEATHSIG = 1
"""Of Linux's prctl."""


def pack(**arrays: Any) -> bytes:
    """A message of arrays."""
    content = io.BytesIO()
    np.savez(content, **arrays)
    return LENGTH.pack(content.tell()) + content.getvalue()


def unpack(content: bytes) -> dict[str, np.ndarray]:
    """The arrays of a message, given without its length."""
    with PARSING, np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        return dict(arrays.items())


def pack_groups(groups: Sequence[Sequence[Mesh]]) -> bytes:
    """A message of groups of meshes: all vertices and faces one after another, and how many there are."""
    meshes = [mesh for group in groups for mesh in group]
    vertices, faces = zip(*meshes, (np.zeros((0, 3)), np.zeros((0, 3), np.int64)))
    counts = np.array([[len(points), len(triangles)] for points, triangles in meshes]).reshape(-1, 2)
    sizes = np.array([len(group) for group in groups], np.int64)
    return pack(vertices=np.concatenate(vertices), faces=np.concatenate(faces), counts=counts, sizes=sizes)


def unpack_groups(content: bytes) -> list[list[Mesh]]:
    """The groups of meshes of a message."""
    arrays = unpack(content)
    ends = np.cumsum(arrays["counts"], axis=0)
    meshes = zip(np.split(arrays["vertices"], ends[:, 0]), np.split(arrays["faces"], ends[:, 1]))
    return [[next(meshes) for _ in range(size)] for size in arrays["sizes"].tolist()]


def main() -> None:
    """Answer each message with the parts there are then, until stdin ends."""
    if sys.platform.startswith("linux"):  # end with the one who asked, even in the middle of a cut
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    # Run by its path, the process finds its own folder where it needs the one that holds the packages.
    own = Path(__file__).resolve().parent
    sys.path[:] = [str(own.parents[1]), *(path for path in sys.path if path != str(own))]

    cutter = None
    while (content := _read(sys.stdin.buffer)) is not None:
        job = unpack(content)
        if "wanted" in job:
            assert cutter is not None
            groups = cutter.halve(job["wanted"].tolist(), job["places"])
        else:
            cutter = begin(job["vertices"], job["faces"], json.loads(str(job["settings"])))
            groups = [cutter.hulls]
        answers.write(pack_groups(groups))
        answers.flush()


def begin(vertices: np.ndarray, faces: np.ndarray, settings: dict[str, Any]) -> Any:
    """A Cutter of a closed mesh [m], in the parts that CoACD makes of it; one part without "coacd"."""
    from reconstruction.export.cutting import Cutter, solid_of

    body = solid_of(vertices, faces)
    if body is not None:
        body = body.simplify(settings["simplify"])
        simple = body.to_mesh()
        vertices, faces = simple.vert_properties[:, :3].astype(float), simple.tri_verts
    if settings["coacd"] is None:
        return Cutter(body, [vertices])
    import coacd

    coacd.set_log_level("off")
    # Remeshing grows thin parts by millimetres: only for what is not manifold.
    mode = "on" if body is None else "off"
    found = coacd.run_coacd(coacd.Mesh(vertices, faces), preprocess_mode=mode, **settings["coacd"])
    return Cutter(body, [np.asarray(points, float) for points, _ in found])


def _read(stream: IO[bytes]) -> bytes | None:
    """The next message's content; None when there is no more."""
    head = stream.read(LENGTH.size)
    if len(head) < LENGTH.size:
        return None
    return stream.read(LENGTH.unpack(head)[0])


if __name__ == "__main__":
    main()
