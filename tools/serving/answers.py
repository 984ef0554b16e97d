"""What the service answers: a request's dict in, the answer's dict out. Knows no sockets."""

from __future__ import annotations

from collections import OrderedDict
from contextlib import suppress
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from mapping.errors import ContraMapError, DataError

if TYPE_CHECKING:
    from perception.frame import Frame
    from reconstruction.config import PipelineConfig
    from reconstruction.result import Reconstruction

KEPT = 8
"""Results kept for later questions, one a client, the latest."""
FIELDS = {
    "ping": frozenset[str](),
    "map": frozenset({"depth", "K", "labels", "rgb", "T_world_camera", "names", "seed", "agreement"}),
    "distance": frozenset({"points", "label"}),
}
"""What each request may hold."""
MOST_POINTS = 1_000_000


class Answers:
    """Maps frames and answers questions about the frame that a client had mapped last."""

    def __init__(self, config: PipelineConfig) -> None:
        self.config = config
        self._results: OrderedDict[bytes, Reconstruction] = OrderedDict()

    def warm_up(self) -> None:
        """Load what the first frame would otherwise wait for."""
        v, u = np.mgrid[:120, :160]
        K = np.array([[150.0, 0, 79.5], [0, 150.0, 59.5], [0, 0, 1]])
        # A table seen from 0.5 m above at 45 degrees, and a block in front of it.
        depth = (0.5 / (np.sqrt(0.5) * ((v - K[1, 2]) / K[1, 1] + 1))).astype(np.float32)
        block = (abs(u - 80) < 15) & (abs(v - 60) < 15)
        depth[block] -= 0.04
        # Whatever it is taken for: everything has been used by then.
        with suppress(ContraMapError):
            self(b"", {"request": "map", "depth": depth, "K": K, "labels": block.astype(np.uint16)})
        self._results.clear()

    def __call__(self, client: bytes, message: dict[str, Any]) -> dict[str, Any]:
        """The answer; raises ContraMapError with what is wrong with the request."""
        request = message.get("request")
        if not isinstance(request, str) or request not in FIELDS:
            raise DataError(f"unknown request {request!r}; valid: {', '.join(FIELDS)}")
        unknown = set(message) - FIELDS[request] - {"request"}
        if unknown:
            valid = ", ".join(sorted(FIELDS[request])) or "none"
            raise DataError(f"{request}: unknown field {sorted(unknown)[0]!r}; valid: {valid}")
        start = perf_counter()
        answer: dict[str, Any] = getattr(self, f"_{request}")(client, message)
        return {"ok": True, "server_ms": round(1e3 * (perf_counter() - start), 3), **answer}

    def _ping(self, client: bytes, message: dict[str, Any]) -> dict[str, Any]:
        from reconstruction.files.scene_json import FORMAT

        return {
            "service": "contramap",
            "format": FORMAT,
            "requests": {k: sorted(v) for k, v in FIELDS.items()},
        }

    def _map(self, client: bytes, message: dict[str, Any]) -> dict[str, Any]:
        from reconstruction.files.trust import trust
        from reconstruction.scene import reconstruct

        seed = message.get("seed") or 0
        if type(seed) is not int or seed < 0:
            raise DataError(f"map: seed must be a whole number of 0 or more, got {seed!r}")
        rays = message.get("agreement") or False
        if type(rays) is not bool:
            raise DataError(f"map: agreement must be true or false, got {rays!r}")
        result = reconstruct(_frame(message), self.config, seed)
        self._results[client] = result
        self._results.move_to_end(client)
        while len(self._results) > KEPT:
            self._results.popitem(last=False)
        return {
            "frame": "world",
            "unit": "m",
            "T_world_table": result.T_world_table,
            "objects": [{**_object(item), "trust": trust(item, result, rays)} for item in result.objects],
            "other": None if result.other is None else _surface(result.other),
            "skipped": [{"label": s.label, "name": s.name, "reason": s.reason} for s in result.skipped],
            "notes": list(result.notes),
            "timings_ms": {stage: float(ms) for stage, ms in result.timings_ms.items()},
        }

    def _distance(self, client: bytes, message: dict[str, Any]) -> dict[str, Any]:
        if client not in self._results:
            raise DataError("distance: this connection has no mapped frame (any more); ask for `map` first")
        points, label = message.get("points"), message.get("label")
        if not isinstance(points, np.ndarray) or points.ndim != 2 or len(points) > MOST_POINTS:
            raise DataError(f"distance: points must be an array (N, 3) of at most {MOST_POINTS} points")
        if label is not None and type(label) is not int:
            raise DataError(f"distance: label must be a whole number or absent, got {label!r}")
        found = self._results[client].distance(points, label)
        return {"distance": found.distance, "gradient": found.gradient, "unknown": found.unknown}


def _frame(message: dict[str, Any]) -> Frame:
    from perception.camera import Camera
    from perception.frame import Frame

    arrays = {name: message.get(name) for name in ("depth", "K", "labels", "rgb", "T_world_camera")}
    for name, value in arrays.items():
        if value is not None and not isinstance(value, np.ndarray):
            raise DataError(f"map: {name} must be an array, got {type(value).__name__}")
    depth, K, pose = arrays["depth"], arrays["K"], arrays["T_world_camera"]
    if depth is None or K is None or depth.ndim != 2:
        raise DataError("map: needs depth, an array (H, W) of floats [m], and K, an array (3, 3) [px]")
    names = message.get("names") or {}
    if not isinstance(names, dict) or not all(isinstance(name, str) for name in names.values()):
        raise DataError('map: names must map labels to texts, such as {"1": "mug"}')
    try:
        named = {int(label): name for label, name in names.items()}
    except ValueError as error:
        raise DataError(f"map: names must have labels as keys ({error})") from error
    camera = Camera(K, depth.shape[1], depth.shape[0], np.eye(4) if pose is None else pose)
    return Frame(depth, camera, arrays["rgb"], arrays["labels"], named, "a message")


def _surface(item: Any) -> dict[str, Any]:
    return {
        "vertices": np.asarray(item.mesh.vertices, np.float64),
        "faces": np.asarray(item.mesh.faces, np.int32),
        "uncertainty": np.asarray(item.uncertainty, np.float32),
    }


def _object(item: Any) -> dict[str, Any]:
    return {
        "label": int(item.label),
        "name": item.name,
        **_surface(item),
        "T_world_object": item.T_world_object,
        "extents": item.extents,
        "mean_uncertainty": item.mean_uncertainty,
    }
