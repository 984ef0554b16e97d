"""Matrix products and the prior's convolutions on two threads, then in forks; run as a program.

Prints how many forks were made and how many of them ended.
"""

from __future__ import annotations

import os
import signal
import threading
import time

import torch

from mapping.threads import Threads
from reconstruction.prior.occlusion_prior import OcclusionPrior

ROUNDS, FORKS = 4, 2
PATIENCE_S = 60.0
"""Given to forks that need milliseconds."""


def work() -> None:
    network = OcclusionPrior.load().network
    with Threads(), torch.inference_mode():
        for _ in range(2):
            network.encode(torch.zeros(1, network.enter.in_channels, 24, 24, 16))
            rows = torch.ones(64, 300)
            torch.linalg.cholesky(rows @ rows.T + torch.eye(64))


def fork() -> int:
    process = os.fork()
    if process == 0:
        try:
            work()
        finally:
            os._exit(0)
    return process


def main() -> None:
    left: set[int] = set()
    torch.set_num_threads(1)
    work()
    for _ in range(ROUNDS):
        working = [threading.Thread(target=work) for _ in range(2)]
        for one in working:
            one.start()
        for one in working:
            one.join()
        left |= {fork() for _ in range(FORKS)}
    end = time.monotonic() + PATIENCE_S
    while left and time.monotonic() < end:
        left -= {process for process in left if os.waitpid(process, os.WNOHANG)[0]}
        time.sleep(0.005)
    print(ROUNDS * FORKS, ROUNDS * FORKS - len(left))
    for process in left:
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)


if __name__ == "__main__":
    main()
