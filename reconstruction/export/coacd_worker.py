"""The process that cuts meshes into convex parts with CoACD; one mesh after another, as asked on stdin.

A process of its own: coacd breaks a later import of open3d in the same process, prints to stdout, holds
Python's lock while it works and cannot be stopped. Knows files of arrays; imports nothing of the project.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
import sys

import numpy as np

PR_SET_PDEATHSIG = 1
"""Of Linux's prctl."""


def main() -> None:
    """For each line {"given": npz, "found": npz, "settings": {...}}: cut, write, answer with one line."""
    if sys.platform.startswith("linux"):  # end with the one who asked, even in the middle of a cut
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
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
