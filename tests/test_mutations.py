"""Frames changed at random: mapped with closed meshes, or refused in words; never anything else."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
import warnings
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from conftest import make_tabletop
from mutations import mutate

from mapping.errors import ContraMapError
from perception import load_frame, save_frame
from reconstruction import reconstruct

LONGEST_S = 30.0
"""Of this process's own time."""
LARGEST_MB = 2048


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("good") / "frame"
    save_frame(make_tabletop(size=(160, 120), noise=0.001).frame, folder)
    return folder


def try_one(good: Path, folder: Path, seed: int) -> tuple[str, str]:
    """Mutation `seed`: what became of it (mapped, refused or a fault), and what was done."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(good, folder)
    done = mutate(folder, np.random.default_rng([15, seed]))
    start = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = reconstruct(load_frame(folder))
    except ContraMapError as error:
        fault = "" if "\n" not in str(error) and str(error) else "a message of several lines"
        outcome = "refused"
    except BaseException as error:
        return f"fault: {type(error).__name__}: {error}", done
    else:
        outcome, fault = "mapped", ""
        for item in found.objects:
            if not (item.watertight and np.isfinite(item.mesh.vertices).all()):
                fault = f"mesh of {item.label} is open or not finite"
            if not ((item.uncertainty >= 0) & (item.uncertainty <= 1)).all():
                fault = f"uncertainty of {item.label} outside 0..1"
    if time.process_time() - start > LONGEST_S:
        fault = f"took {time.process_time() - start:.0f} s"
    return f"fault: {fault}" if fault else outcome, done


def run(good: Path, folder: Path, seeds: range) -> Counter[str]:
    """Count outcomes; faults are listed in full."""
    counts: Counter[str] = Counter()
    for seed in seeds:
        outcome, done = try_one(good, folder, seed)
        counts[outcome if not outcome.startswith("fault") else f"{outcome} (seed {seed}; {done})"] += 1
    return counts


def test_mutated_frames_are_mapped_or_refused(good: Path, tmp_path: Path) -> None:
    counts = run(good, tmp_path / "frame", range(40))
    assert counts["mapped"] > 3
    assert counts["refused"] > 3
    assert set(counts) == {"mapped", "refused"}


def test_bytes_read_as_depth_are_no_measurement(good: Path, tmp_path: Path) -> None:
    """A byte more in depth.npy makes every number another one, some of them 1e30 m."""
    assert try_one(good, tmp_path / "frame", 1662)[0] in ("mapped", "refused")


@pytest.mark.slow
def test_2000_mutated_frames(good: Path, tmp_path: Path) -> None:
    """In a process of its own with 2 GB of memory more than it starts with."""
    program = "import sys, test_mutations; test_mutations.main(*sys.argv[1:])"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([*sys.path, str(Path(__file__).parent)])}
    command = [sys.executable, "-c", program, str(good), str(tmp_path / "frame"), "0", "2000"]
    answer = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert set(json.loads(answer.stdout)) == {"mapped", "refused", "peak_mb"}, answer.stdout


def main(good: str, folder: str, first: str, last: str) -> None:
    """Print the outcomes of some seeds as JSON, and the most memory used."""
    import resource

    counts: dict[str, float] = dict(run(Path(good), Path(folder), range(int(first), int(last))))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    counts["peak_mb" if peak < LARGEST_MB else f"fault: {peak:.0f} MB"] = peak
    print(json.dumps(counts, indent=1))
