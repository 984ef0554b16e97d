"""Hands meshes to a CoACD process, waits for a limited time, and starts a new one after a failure."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from mapping.folders import scratch_folder

WORKER = Path(__file__).with_name("coacd_worker.py")


class CoacdProcess:
    """One worker process, started when first needed; cut one mesh at a time."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None

    def cut(self, mesh: trimesh.Trimesh, settings: dict[str, Any], limit_s: float) -> list[np.ndarray]:
        """Vertices (N, 3) [m] of each convex part; [] when it took too long or failed."""
        with scratch_folder("parts") as folder:
            given, found = folder / "mesh.npz", folder / "parts.npz"
            np.savez(given, vertices=np.asarray(mesh.vertices), faces=np.asarray(mesh.faces))
            job = {"given": str(given), "found": str(found), "settings": settings}
            if not self._answered(json.dumps(job), limit_s) or not found.is_file():
                self.close()
                return []
            with np.load(found) as parts:
                return [parts[name] for name in parts.files]

    def close(self) -> None:
        """End the process, whatever it is doing."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None

    def _answered(self, job: str, limit_s: float) -> bool:
        if self._process is None:
            # One thread a process: several run side by side, and results do not depend on timing.
            self._process = subprocess.Popen(
                [sys.executable, str(WORKER)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                env={**os.environ, "OMP_NUM_THREADS": "1"},
            )
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            process.stdin.write(job + "\n")
            process.stdin.flush()
        except OSError:
            return False
        ready, _, _ = select.select([process.stdout], [], [], limit_s)
        return bool(ready) and process.stdout.readline() == "done\n"
