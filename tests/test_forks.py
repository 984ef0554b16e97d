"""Forks made right after work on several threads."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from mapping import forks

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
HERE = Path(__file__).parent


def test_forks_right_after_threads_do_not_spin_in_matrix_products() -> None:
    """Without the wait half of them inherit a lock of MKL that nobody opens."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([*sys.path, str(HERE)])}
    command = [sys.executable, str(HERE / "forked_products.py")]
    answer = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert answer.returncode == 0, answer.stderr
    made, ended = answer.stdout.split()
    assert made == ended != "0"


def test_numbers_of_threads_that_are_gone_are_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    """A service that makes threads for ever and never forks."""
    monkeypatch.setattr(forks, "_worked", set(range(-forks.MANY, 0)))
    forks.note_worker()
    assert forks._worked == {threading.get_native_id()}


def test_a_fork_does_not_wait_for_threads_that_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(forks, "_worked", set())
    over = threading.Event()
    going_on = threading.Thread(target=lambda: (forks.note_worker(), over.wait()))
    going_on.start()
    while not forks._worked:
        pass
    monkeypatch.setattr(forks.time, "sleep", lambda seconds: pytest.fail("waited"))
    forks._wait_for_the_ending()
    over.set()
    going_on.join()
