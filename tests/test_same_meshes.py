"""After a reconstruction, others give the same meshes to the byte: two threads at once, a fork, a process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("same_meshes.py")


def digests(*arguments: str) -> dict[str, set[str]]:
    """How the meshes were made -> the digests of them."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([*sys.path, str(SCRIPT.parent)])}
    command = [sys.executable, str(SCRIPT), *arguments]
    answer = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=280)
    assert answer.returncode == 0, answer.stderr
    found: dict[str, set[str]] = {}
    for line in answer.stdout.splitlines():
        how, digest = line.split()
        found.setdefault(how, set()).add(digest)
    return found


def test_two_threads_and_a_fork_give_the_same_meshes() -> None:
    found = digests()
    assert set(found) == {"alone", "thread", "again"} | ({"fork"} if hasattr(os, "fork") else set())
    assert len(set.union(*found.values())) == 1


@pytest.mark.slow
def test_a_spawned_process_gives_the_same_meshes() -> None:
    found = digests("spawn")
    assert found["spawn"] == found["alone"]
