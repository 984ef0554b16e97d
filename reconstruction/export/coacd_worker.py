"""The process that cuts meshes into convex parts with CoACD; one mesh after another, as asked on stdin.

A process of its own: coacd breaks a later import of open3d in the same process, prints to stdout, holds
Python's lock while it works and cannot be stopped. Knows files of arrays; imports nothing of the project.
"""

from __future__ import annotations

import json
import os
import sys

import numpy as np


def main() -> None:
    """For each line {"given": npz, "found": npz, "settings": {...}}: cut, write, answer with one line."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    import coacd

    coacd.set_log_level("off")
    for line in sys.stdin:
        job = json.loads(line)
        with np.load(job["given"]) as given:
            mesh = coacd.Mesh(given["vertices"], given["faces"])
        parts = coacd.run_coacd(mesh, **job["settings"])
        np.savez(job["found"], *[np.asarray(vertices, float) for vertices, _ in parts])
        answers.write("done\n")
        answers.flush()


if __name__ == "__main__":
    main()
