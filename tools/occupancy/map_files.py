"""An occupancy map as the map servers of robots read it: `map.pgm` with `map.yaml`; and the probabilities.

Knows probabilities on an even lattice; must not know logs or kernels.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mapping.files import temporary_beside, write_atomically
from tools.occupancy.fit import UNCERTAIN, share_occupied

OCCUPIED_GREY, UNKNOWN_GREY, FREE_GREY = 0, 205, 254
"""Grey values that map_server and nav2_map_server use for the three states."""
OCCUPIED_FROM, FREE_BELOW = 0.65, 0.196
"""Their thresholds of the probability that a grey value stands for, (255 - grey) / 255."""


def states(probabilities: np.ndarray, unknown_from: float) -> np.ndarray:
    """Grey values (A, B) uint8: unknown from p(uncertain) = `unknown_from` on, or where neither is likely."""
    occupied = share_occupied(probabilities)
    known = probabilities[..., UNCERTAIN] < unknown_from
    grey = np.full(occupied.shape, UNKNOWN_GREY, np.uint8)
    grey[known & (occupied > OCCUPIED_FROM)] = OCCUPIED_GREY
    grey[known & (occupied < FREE_BELOW)] = FREE_GREY
    return grey


def write_map(
    out: Path,
    probabilities: np.ndarray,
    axes: tuple[np.ndarray, np.ndarray],
    resolution: float,
    unknown_from: float,
) -> dict[str, float]:
    """Write map.pgm, map.yaml and map.npz; returns the share of cells in each state.

    probabilities: (A, B, 3) free, occupied, uncertain at the cells' centres; axes: their x and y [m], rising
    in steps of `resolution`.
    """
    grey = states(probabilities, unknown_from)
    image = np.flipud(grey.T)  # rows of a picture run from the top, y from below
    header = f"P5\n{image.shape[1]} {image.shape[0]}\n255\n".encode()
    write_atomically(out / "map.pgm", header + np.ascontiguousarray(image).tobytes())
    x, y = (float(axis[0] - resolution / 2) for axis in axes)
    settings = [
        "image: map.pgm",
        "mode: trinary",
        f"resolution: {resolution:.6g}",
        f"origin: [{x:.6f}, {y:.6f}, 0.0]",
        "negate: 0",
        f"occupied_thresh: {OCCUPIED_FROM}",
        f"free_thresh: {FREE_BELOW}",
    ]
    write_atomically(out / "map.yaml", ("\n".join(settings) + "\n").encode())
    with temporary_beside(out / "map.npz") as partial, partial.open("wb") as file:
        np.savez_compressed(
            file,
            probabilities=probabilities.astype(np.float16),
            x=axes[0],
            y=axes[1],
            classes=np.array(["free", "occupied", "uncertain"]),
        )
    shares = {"free": FREE_GREY, "occupied": OCCUPIED_GREY, "unknown": UNKNOWN_GREY}
    return {name: float((grey == value).mean()) for name, value in shares.items()}
