"""Prints digests of one scene's meshes: alone, from two threads at once, in a fork and, when asked for, in a
spawned process. One line each: how, digest."""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch
from conftest import Shape, make_tabletop

from reconstruction import reconstruct

THREADS = 2


def digest(_: int = 0) -> str:
    frame = make_tabletop((Shape("sphere", (0.05,), (0.0, 0.0, 0.05)),), size=(160, 120), noise=0.001).frame
    parts = [
        np.ascontiguousarray(values).tobytes()
        for item in reconstruct(frame).objects
        for values in (item.mesh.vertices, item.mesh.faces, item.uncertainty)
    ]
    assert parts
    return hashlib.sha256(b"".join(parts)).hexdigest()


def say(how: str, found: str) -> None:
    print(how, found, flush=True)


if __name__ == "__main__":
    torch.set_num_threads(THREADS)
    say("alone", digest())
    with ThreadPoolExecutor(2) as pool:
        for found in pool.map(digest, range(2)):
            say("thread", found)
    if hasattr(os, "fork"):
        child = os.fork()
        if child == 0:
            say("fork", digest())
            os._exit(0)
        os.waitpid(child, 0)
    if "spawn" in sys.argv:
        spawned = multiprocessing.get_context("spawn")
        with spawned.Pool(1, torch.set_num_threads, (THREADS,)) as workers:
            say("spawn", workers.map(digest, [0])[0])
    say("again", digest())
