"""Many reconstructions in one process, on its threads, in forks and in fresh processes; run as a program.

    python tests/long_runs.py 500

Prints memory, descriptors and threads after every tenth of them, and how many different results there were.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import sys
import threading
from pathlib import Path

import numpy as np
from conftest import Shape, make_tabletop

from reconstruction import reconstruct

SHAPES = (
    Shape("box", (0.06, 0.10, 0.08), (0.05, 0.08, 0.04), 0.4),
    Shape("sphere", (0.04,), (-0.02, -0.08, 0.04)),
)
ON_THREADS, IN_FORKS, IN_FRESH = 10, 5, 3
"""Reconstructions on each of four threads; forks and fresh processes, of one reconstruction each."""


def result(_: int = 0) -> str:
    """The meshes of a small frame with all that belongs to them, as one number."""
    frame = make_tabletop(SHAPES, size=(120, 90), noise=0.001).frame
    found = hashlib.sha256()
    for item in reconstruct(frame).objects:
        for array in (item.mesh.vertices, item.mesh.faces, item.uncertainty, item.T_world_object):
            found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()


def held() -> dict[str, float]:
    """What this process holds: memory [MB], descriptors, threads of Python."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return {
        "mb": round(pages * os.sysconf("SC_PAGESIZE") / 2**20, 1),
        "descriptors": len(os.listdir("/proc/self/fd")),
        "threads": threading.active_count(),
    }


def in_fork() -> str:
    """The result of a fork of this process."""
    read, write = os.pipe()
    process = os.fork()
    if process == 0:
        try:
            os.write(write, result().encode())
        finally:
            os._exit(0)
    os.close(write)
    with os.fdopen(read) as stream:
        found = stream.read()
    os.waitpid(process, 0)
    return found


def main(count: int) -> None:
    results = {result() for _ in range(10)}
    figures = [{"after": 0, **held()}]

    def note(after: int | str) -> None:
        figures.append({"after": after, **held()})  # type: ignore[dict-item]
        print(figures[-1], file=sys.stderr, flush=True)

    for number in range(count):
        results.add(result())
        if (number + 1) % max(1, count // 10) == 0:
            note(number + 1)

    def ask() -> None:
        for _ in range(ON_THREADS):
            results.add(result())

    for after in ("threads", "threads again"):
        asking = [threading.Thread(target=ask) for _ in range(4)]
        for one in asking:
            one.start()
        for one in asking:
            one.join()
        note(after)
    results.update(in_fork() for _ in range(IN_FORKS))
    note("forks")
    print(json.dumps({"held": figures, "results": len(results)}), flush=True)
    with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as pool:
        fresh = set(pool.map(result, range(IN_FRESH), chunksize=1))
    assert fresh == results, "fresh processes make other meshes"


if __name__ == "__main__":
    main(int(sys.argv[1]))
