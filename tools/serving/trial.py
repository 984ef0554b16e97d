"""A service under way, tried from outside: frames timed, clients that are killed or talk nonsense, memory.

Knows the client and the process; knows nothing of what the service does with a frame.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from mapping.errors import DataError

START_S = 120.0
"""Seconds that a service is given to start."""
KILLED_CLIENT = """
import sys
sys.path.insert(0, sys.argv[1])
import numpy as np
from client import Client
with np.load(sys.argv[3]) as frame:
    client = Client(sys.argv[2])
    print("asks", flush=True)
    while True:
        client.map(**frame)
"""
Frame = dict[str, np.ndarray]
"""The fields of a `map` request."""


@dataclass(frozen=True)
class Service:
    """A running `contramap serve`: its address, and what its process holds."""

    address: str
    process: subprocess.Popen[str]

    def held(self) -> dict[str, float]:
        """Memory [MB], descriptors and threads of the service; nothing where /proc is absent."""
        folder = Path(f"/proc/{self.process.pid}")
        if not folder.is_dir():
            return {}
        pages = int((folder / "statm").read_text().split()[1])
        return {
            "memory_mb": round(pages * os.sysconf("SC_PAGESIZE") / 1e6, 1),
            "descriptors": len(os.listdir(folder / "fd")),
            "threads": len(os.listdir(folder / "task")),
        }


@contextmanager
def running_service(max_mb: float) -> Iterator[Service]:
    """A service of its own process on a free port; ended at the end. Raises DataError when none starts."""
    command = [sys.executable, "-m", "tools.cli", "serve", "--port", "0", "--max-mb", f"{max_mb:g}"]
    root = str(Path(__file__).resolve().parents[2])
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([root, os.environ.get("PYTHONPATH", "")])}
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        said = process.stdout.readline()
        if " on tcp://" not in said:
            raise DataError("the service did not start; `contramap serve` says why")
        yield Service(said.split(" on ")[1].split(";")[0], process)
    finally:
        process.kill()
        process.communicate()


def timed_map(client: Any, frame: Frame) -> dict[str, float]:
    """One frame: milliseconds that the client waited, that the library took, and what lies between."""
    start = perf_counter()
    answer = client.map(**frame)
    waited = 1e3 * (perf_counter() - start)
    library = answer["timings_ms"]["total"]
    return {"waited_ms": waited, "library_ms": library, "overhead_ms": waited - library}


def troubles(service: Service, frame: Frame, largest: int, folder: Path) -> dict[str, Callable[[], None]]:
    """What clients do to a service, by name; each raises DataError when the answer is not what it must be."""
    import zmq

    from tools.serving.messages import encode

    here = str(Path(__file__).resolve().parent)
    np.savez(folder / "frame.npz", **frame)  # type: ignore[arg-type]
    message = encode({"request": "map", **frame})

    def answered(content: bytes, words: str) -> None:
        import msgpack

        with zmq.Context() as context, context.socket(zmq.REQ) as one:
            one.setsockopt(zmq.LINGER, 0)
            one.setsockopt(zmq.RCVTIMEO, 60_000)
            one.connect(service.address)
            one.send(content)
            try:
                answer = msgpack.unpackb(one.recv())
            except zmq.Again:
                raise DataError(f"no answer to {content[:20]!r}...") from None
        if answer["ok"] or words not in answer["error"]:
            raise DataError(f"{content[:20]!r}... was answered with {answer}")

    def gone(content: bytes) -> None:
        """A client that asks and does not wait."""
        with zmq.Context() as context, context.socket(zmq.DEALER) as one:
            one.setsockopt(zmq.LINGER, 200)
            one.connect(service.address)
            one.send_multipart([b"", content])

    def killed() -> None:
        command = [sys.executable, "-c", KILLED_CLIENT, here, service.address, str(folder / "frame.npz")]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
            assert process.stdout is not None
            process.stdout.readline()
            process.kill()

    def plain_bytes() -> None:
        """Somebody who does not speak ZeroMQ at all."""
        host, port = service.address.removeprefix("tcp://").rsplit(":", 1)
        with socket.create_connection((host, int(port)), timeout=10) as stream:
            stream.sendall(b"GET / HTTP/1.1\r\n\r\n" + bytes(1000))

    return {
        "client killed in the middle of a request": killed,
        "client gone without waiting": lambda: gone(message),
        "half a message": lambda: answered(message[: len(message) // 2], "not a msgpack"),
        "bytes of no message": lambda: answered(b"\xc1" + bytes(999), "not a msgpack"),
        "more than --max-mb": lambda: answered(bytes(largest + 1), "more than the"),
        "many times --max-mb": lambda: gone(bytes(5 * largest)),
        "bytes of no protocol": plain_bytes,
    }
