"""`contramap look RESULT`: which camera pose is expected to take most of the uncertainty away."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from mapping.errors import ConfigError


def look(
    result: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RESULT")],
    candidates: int = 12,
    poses: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Rank camera poses by how much p(uncertain) around the objects they are expected to take away.

    Example: contramap look result --candidates 12 --json look.json

    Args:
        result: Result folder of `contramap map`.
        candidates: Poses on a circle around the objects, as far and as high as the camera of the frame.
        poses: JSON file with a list of 4x4 T_world_camera instead (OpenCV axes, metres).
        json: Also write poses and gains to this file.
    """
    import numpy as np

    from mapping.guarded_files import read_json
    from reconstruction.files.stored import load_result
    from reconstruction.looking import next_view, poses_around
    from tools.options import write_json

    if candidates < 1:
        raise ConfigError(f"--candidates must be at least 1, got {candidates}")
    stored = load_result(result)
    if poses is not None:
        try:
            chosen = np.array(read_json(poses, "give a list of 4x4 matrices"), float).reshape(-1, 4, 4)
        except (TypeError, ValueError) as error:
            raise ConfigError(f"{poses}: must hold a list of 4x4 matrices ({error})") from error
    else:
        chosen = poses_around(stored, candidates)
    ranked = next_view(stored, chosen)
    print("pose  takes away  camera at x, y, z [m]")
    for index in ranked.order:
        x, y, z = ranked.poses[index, :3, 3]
        print(f"{index:>4}  {ranked.gains[index]:>10.1%}  {x:.3f}, {y:.3f}, {z:.3f}")
    share = ranked.gains[ranked.best]
    print(f"next view: pose {ranked.best}, expected to take {share:.0%} of p(uncertain) away")
    write_json(
        {
            "best": ranked.best,
            "poses": [
                {"T_world_camera": pose.tolist(), "gain": float(gain)}
                for pose, gain in zip(ranked.poses, ranked.gains)
            ],
        },
        json,
    )
