"""Laser logs of any kind this project reads, by their file: CARMEN logs and .npz files of scans with poses.

Knows files and the arrays in them; must not know maps or what a beam means.
"""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from mapping.errors import DataError
from perception.lidar import LaserLog, load_carmen

TOP = 0.02
"""Ranges within this share of the log's largest one are looked at for readings that mean "no return"."""
PEAK = 5.0
"""They mean that where they are this many times as many as those in the equally wide band before them."""


def load_laser_log(path: str | Path) -> LaserLog:
    """A CARMEN log, plain or gzipped, or an .npz with `poses` (S, 3) x, y [m], yaw [rad] and `ranges` (S, B)
    [m], optionally `angles` (B,) [rad] and `times` (S,) [s].

    Raises DataError naming the file, what is wrong and how to mend it.
    """
    path = Path(path)
    if path.is_dir():
        raise DataError(f"{path}: a folder; name one log, a CARMEN file or an .npz of scans with poses")
    return _load_npz(path) if path.suffix == ".npz" else load_carmen(path)


def longest_return(log: LaserLog) -> float:
    """The range [m] up to which readings of this log are returns.

    Lasers report "no return" as their largest range, again and again: a peak at the end of the ranges.
    Without such a peak every finite range counts.
    """
    ranges: np.ndarray = log.ranges[np.isfinite(log.ranges) & (log.ranges > 0)]
    if not len(ranges):
        raise DataError(f"{log.name}: no finite range > 0 in the whole log; nothing was measured")
    largest = float(np.max(ranges))
    edge = (1 - TOP) * largest
    top = int((ranges >= edge).sum())
    before = int(((ranges < edge) & (ranges >= (1 - 2 * TOP) * largest)).sum())
    return edge if top > PEAK * max(before, 1) else largest


def _load_npz(path: Path) -> LaserLog:
    if not path.is_file():
        raise DataError(f"{path}: no such log file")
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise DataError(f"{path}: not a readable .npz file ({error}); write it with numpy.savez") from error
    for name in ("poses", "ranges"):
        if name not in arrays:
            raise DataError(
                f"{path}: no array {name!r}, found {sorted(arrays)}; wanted poses (S, 3) x, y, yaw and "
                "ranges (S, B)"
            )
    try:
        poses, ranges = (arrays[name].astype(np.float64) for name in ("poses", "ranges"))
    except ValueError as error:
        raise DataError(f"{path}: poses and ranges must be numbers ({error})") from error
    if poses.ndim != 2 or poses.shape[1] != 3 or ranges.ndim != 2 or len(poses) != len(ranges):
        raise DataError(f"{path}: wanted poses (S, 3) and ranges (S, B), got {poses.shape}, {ranges.shape}")
    angles = arrays.get("angles")
    if angles is not None and (angles.shape != ranges.shape[1:] or not np.isfinite(angles).all()):
        raise DataError(f"{path}: angles must be {ranges.shape[1]} finite numbers [rad], got {angles.shape}")
    times = arrays.get("times", np.arange(len(poses), dtype=np.float64))
    usable = np.isfinite(poses).all(axis=1) & (ranges.shape[1] > 0)
    if not usable.any():
        raise DataError(f"{path}: no scan with a finite pose and at least one beam")
    return LaserLog(
        path.stem, poses[usable], ranges[usable], times[usable], int((~usable).sum()), beam_angles_=angles
    )
