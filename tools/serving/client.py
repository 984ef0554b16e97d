"""A client of `contramap serve` for any robot: copy this file. Needs numpy, pyzmq and msgpack, nothing
else."""

import msgpack
import numpy as np
import zmq


def pack(value):
    """Arrays as {dtype, shape, data}."""
    value = np.ascontiguousarray(value)
    return {"dtype": value.dtype.str, "shape": list(value.shape), "data": value.tobytes()}


def unpack(value):
    """The reverse of pack."""
    if set(value) == {"dtype", "shape", "data"}:
        return np.frombuffer(value["data"], value["dtype"]).reshape(value["shape"])
    return value


class Client:
    """One connection, for one thread. Raises RuntimeError with the server's words, TimeoutError in
    silence."""

    def __init__(self, address="tcp://127.0.0.1:5560", timeout_s=30.0):
        context = zmq.Context.instance()  # type: zmq.Context
        self.socket = context.socket(zmq.REQ)
        self.socket.setsockopt(zmq.RCVTIMEO, int(1e3 * timeout_s))
        for option, value in ((zmq.LINGER, 0), (zmq.REQ_RELAXED, 1), (zmq.REQ_CORRELATE, 1)):
            self.socket.setsockopt(option, value)
        self.socket.connect(address)

    def ask(self, request, **fields):
        """Send one request and wait for its answer, a dict."""
        self.socket.send(msgpack.packb(dict(fields, request=request), default=pack))
        try:
            answer = msgpack.unpackb(self.socket.recv(), object_hook=unpack)
        except zmq.Again:
            raise TimeoutError("no answer from the server") from None
        if not answer["ok"]:
            raise RuntimeError(answer["error"])
        return answer

    def map(self, depth, K, labels=None, T_world_camera=None, **more):
        """depth (H, W) [m], K (3, 3), labels (H, W) -> objects with vertices [m], faces, uncertainty, trust.

        agreement=True: trust says how far each mesh agrees with the depth image, too (about 0.1 s more)."""
        return self.ask("map", depth=depth, K=K, labels=labels, T_world_camera=T_world_camera, **more)

    def distance(self, points, label=None):
        """Distance [m], gradient and unknown at points (N, 3) [m, world], in the frame mapped last."""
        return self.ask("distance", points=points, label=label)
