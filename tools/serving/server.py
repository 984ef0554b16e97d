"""The service's socket: ZeroMQ, many clients, one frame at a time. Knows messages and how to answer
errors."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable
from typing import Any

from mapping.errors import ConfigError, ContraMapError
from tools.serving.messages import decode, encode

Answer = Callable[[bytes, dict[str, Any]], dict[str, Any]]
"""From a client's identity and its message to the answer."""
HARD_LIMIT = 4
"""Messages this many times larger than allowed are not even received: their connection is closed."""
WAITING = 16
"""Messages that may wait for each client, in either direction."""


class Server:
    """Listens until stopped. A client that is gone, slow or sends nonsense costs the others nothing."""

    def __init__(self, answer: Answer, host: str, port: int, largest: int) -> None:
        """largest: bytes of a message. port: 0 takes a free one. Raises ConfigError when it is taken."""
        import zmq

        self._zmq, self._answer, self._largest = zmq, answer, largest
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.ROUTER)
        for option, value in (
            (zmq.MAXMSGSIZE, HARD_LIMIT * largest),
            (zmq.RCVHWM, WAITING),
            (zmq.SNDHWM, WAITING),
            (zmq.LINGER, 0),
            (zmq.IPV6, 1 if ":" in host else 0),
        ):
            self._socket.setsockopt(option, value)
        place = f"[{host}]" if ":" in host else host
        try:
            self._socket.bind(f"tcp://{place}:{port or '*'}")
        except zmq.ZMQError as error:
            self.close()
            raise ConfigError(f"cannot listen on {host}:{port} ({error}); choose another --port") from error
        self.address = self._socket.getsockopt_string(zmq.LAST_ENDPOINT).rstrip("\0")

    def serve(self, until: Callable[[], bool] = lambda: False, poll_ms: int = 200) -> None:
        """Answer one message after another; `until` is asked a few times a second whether to stop."""
        while not until():
            if self._socket.poll(poll_ms):
                self._serve_one()

    def close(self) -> None:
        """Stop listening."""
        self._socket.close(0)
        self._context.term()

    def _serve_one(self) -> None:
        frames = self._socket.recv_multipart()
        client, envelope, content = frames[0], frames[1:-1], frames[-1]
        try:
            answer = self._answer(client, decode(content, self._largest))
        except ContraMapError as error:
            answer = {"ok": False, "kind": type(error).__name__, "error": " ".join(str(error).split())}
        except Exception as error:  # one client's bad luck must not end the service for all
            traceback.print_exc(file=sys.stderr)
            answer = {"ok": False, "kind": "internal", "error": f"internal error ({type(error).__name__})"}
        try:
            # A client that is gone or does not read gets nothing; nobody waits for it.
            self._socket.send_multipart([client, *envelope, encode(answer)], self._zmq.NOBLOCK)
        except self._zmq.ZMQError:
            return
