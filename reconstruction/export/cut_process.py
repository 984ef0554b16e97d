"""Hands meshes to a process that cuts them, waits for a limited time, and starts a new one after
a failure."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
import trimesh

from reconstruction.export.cut_worker import LENGTH, pack, unpack_groups
from reconstruction.export.cutting import Surface

WORKER = Path(__file__).with_name("cut_worker.py")


class CutFailedError(Exception):
    """A process died or took too long; the text says which."""


class NoProcessError(CutFailedError):
    """No process could be started."""


class CutProcess:
    """One process, started when first needed; it cuts one mesh at a time."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._deadline = 0.0

    def begin(self, mesh: trimesh.Trimesh, settings: dict[str, Any], limit_s: float) -> list[Surface]:
        """The first convex parts of a closed mesh [m], which `halve` cuts further within `limit_s` from now.

        Raises CutFailedError, NoProcessError.
        """
        self._deadline = monotonic() + limit_s
        words = np.array(json.dumps(settings))
        (hulls,) = self._ask(
            pack(vertices=np.asarray(mesh.vertices), faces=np.asarray(mesh.faces), settings=words)
        )
        return hulls

    def halve(self, wanted: Sequence[int], places: np.ndarray) -> list[list[Surface]]:
        """As Cutter.halve. Raises CutFailedError."""
        return self._ask(pack(wanted=np.array(wanted, np.int64), places=places))

    def close(self) -> None:
        """End the process, whatever it is doing."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None

    def _ask(self, message: bytes) -> list[list[Surface]]:
        try:
            process = self._started()
            assert process.stdin is not None
            process.stdin.write(message)
            process.stdin.flush()
            (length,) = LENGTH.unpack(self._read(LENGTH.size))
            return unpack_groups(self._read(length))
        except OSError as error:
            reason = self._how_it_ended() or f"could not be reached ({error.strerror or error})"
            self.close()
            raise CutFailedError(f"the cutting process {reason}") from error
        except CutFailedError:
            self.close()
            raise

    def _read(self, length: int) -> bytes:
        """The next bytes of the answer."""
        assert self._process is not None
        assert self._process.stdout is not None
        stream, found = self._process.stdout, bytearray()
        while len(found) < length:
            ready, _, _ = select.select([stream], [], [], max(0.0, self._deadline - monotonic()))
            if not ready:
                raise CutFailedError("the cutting process took too long")
            some = os.read(stream.fileno(), length - len(found))
            if not some:
                raise BrokenPipeError("no answer")
            found += some
        return bytes(found)

    def _how_it_ended(self) -> str | None:
        if self._process is None:
            return None
        try:
            code = self._process.wait(1.0)
        except subprocess.TimeoutExpired:
            return None
        return f"ended with signal {-code}" if code < 0 else f"ended with exit code {code}"

    def _started(self) -> subprocess.Popen[bytes]:
        if self._process is None:
            # One thread a process: several run side by side, and results do not depend on timing.
            try:
                self._process = subprocess.Popen(
                    [sys.executable, str(WORKER)],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL,
                    env={**os.environ, "OMP_NUM_THREADS": "1"},
                )
            except OSError as error:
                raise NoProcessError(f"no process could be started ({error.strerror or error})") from error
        return self._process
