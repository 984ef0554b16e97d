"""Compile the loops that mapping a frame needs, once on a machine, so that no first frame is slow.

    python -m tools.compile_loops

Knows the scene that ships with the package, and maps it; numba keeps what it compiles. `make demo` and `make
test` run it after the installation; without it, the first frame takes as much longer.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from time import perf_counter


def compile_loops() -> float:
    """Map the shipped scene, from one view and several, and ask the map; the seconds that this took."""
    from perception import load_frame
    from reconstruction import reconstruct
    from sim_scenes.shipped_scene import unpack

    with tempfile.TemporaryDirectory() as folder:
        frame = load_frame(unpack(Path(folder) / "scene"))
        start = perf_counter()
        reconstruct(frame).query(frame.camera.T_world_camera[None, :3, 3])
        reconstruct([frame, frame]).update(frame)  # several views have loops of their own
        return perf_counter() - start


if __name__ == "__main__":
    print("Compiling the inner loops, once on this machine: a minute or two ...", flush=True)
    print(f"done in {compile_loops():.0f} s")
