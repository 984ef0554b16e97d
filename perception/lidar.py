"""Planar laser logs: read CARMEN files, turn beams into occupied and free points. 2D, world frame, metres."""

from __future__ import annotations

import gzip
import zlib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mapping.errors import DataError
from perception.carmen_lines import parse_flaser, parse_robotlaser

LARGEST_CORRUPT_SHARE = 0.5
"""A log with more unreadable laser lines than this share is refused."""


@dataclass(frozen=True)
class LaserLog:
    """Scans of one planar laser, with corrected poses.

    name: file name without endings. poses: (S, 3) x, y [m] and yaw [rad] of the laser in the world.
    ranges: (S, B) [m]. times: (S,) [s], as logged (some logs hold a constant).
    corrupt_lines: laser lines (or scans) that could not be read and were left out. beam_angles_: (B,) [rad],
    where the log says them.
    """

    name: str
    poses: np.ndarray
    ranges: np.ndarray
    times: np.ndarray
    corrupt_lines: int = 0
    beam_angles_: np.ndarray | None = None

    @property
    def angles(self) -> np.ndarray:
        """(B,) beam angles [rad] in the laser's frame."""
        return beam_angles(self.ranges.shape[1]) if self.beam_angles_ is None else self.beam_angles_


@dataclass(frozen=True)
class BeamConfig:
    """How a beam becomes labelled points."""

    range_max: float = 40.0
    """Ranges beyond this mean "no return" and are dropped [m]."""
    free_step: float = 2.0
    """One free point per this length of a beam, and at least one [m]."""
    free_gap: float = 0.1
    """Free points stay this far in front of the end point [m]."""


def beam_angles(count: int) -> np.ndarray:
    """(count,) beam angles [rad] from -90 degrees; an odd count ends at +90, an even one a step before."""
    return np.linspace(-np.pi / 2, np.pi / 2, count, endpoint=bool(count % 2))


def load_carmen(path: str | Path) -> LaserLog:
    """Read the FLASER lines of a CARMEN log, plain or gzipped; without any, its ROBOTLASER1 lines.

    Lines that do not parse, hold NaN or negative ranges, or have another beam count than most are left out
    and counted in `corrupt_lines`. Raises DataError when the file is missing or broken, holds no laser line,
    or most of its laser lines are corrupt.
    """
    path = Path(path)
    text = _read_lines(path)
    tag, parse = "FLASER", parse_flaser
    if not any(line.startswith(tag) for line in text):
        tag, parse = "ROBOTLASER1", parse_robotlaser
    lines = [line for line in text if line.startswith(tag)]
    if not lines:
        raise DataError(
            f"{path}: no FLASER or ROBOTLASER1 line; this reader wants a CARMEN log "
            "(`FLASER count ranges pose ...`)"
        )
    scans = [scan for scan in map(parse, lines) if scan is not None]
    if scans:
        beams = Counter(len(scan.ranges) for scan in scans).most_common(1)[0][0]
        scans = [scan for scan in scans if len(scan.ranges) == beams]
    corrupt = len(lines) - len(scans)
    if corrupt > LARGEST_CORRUPT_SHARE * len(lines):
        raise DataError(f"{path}: {corrupt} of {len(lines)} {tag} lines are corrupt; is this a CARMEN log?")
    ranges, poses, times = (
        np.array([getattr(scan, name) for scan in scans]) for name in ("ranges", "pose", "time")
    )
    name = path.name.removesuffix(".gz").removesuffix(".log").removesuffix("-corrected").removesuffix(".gfs")
    return LaserLog(name, poses, ranges, times, corrupt, scans[0].angles)


def end_points(log: LaserLog, scans: np.ndarray | None = None) -> np.ndarray:
    """(S, B, 2) beam end points [m] in the world; scans: indices of the scans wanted, all by default."""
    poses, ranges = _select(log, scans)
    return poses[:, None, :2] + ranges[..., None] * _directions(poses, log.angles)


def occupancy_samples(
    log: LaserLog,
    rng: np.random.Generator,
    scans: np.ndarray | None = None,
    config: BeamConfig | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Labelled points of the scans' beams: one occupied end point each, and free points before it.

    Returns points (N, 2) [m] in the world and labels (N,) int64, 0 free and 1 occupied. A beam of length d
    has max(1, int(d / free_step)) free points, uniform on [0, d - free_gap].
    """
    config = config or BeamConfig()
    poses, ranges = _select(log, scans)
    directions = _directions(poses, log.angles)
    seen = (ranges > config.free_gap) & (ranges <= config.range_max)
    origin = np.broadcast_to(poses[:, None, :2], directions.shape)[seen]  # (M, 2)
    direction, length = directions[seen], ranges[seen]
    count = np.maximum(1, (length / config.free_step).astype(np.int64))
    beam = np.repeat(np.arange(length.size), count)  # (F,)
    distance = rng.uniform(0.0, 1.0, beam.size) * (length[beam] - config.free_gap)
    occupied = origin + length[:, None] * direction
    free = origin[beam] + distance[:, None] * direction[beam]
    labels = np.concatenate([np.ones(len(occupied), np.int64), np.zeros(len(free), np.int64)])
    return np.concatenate([occupied, free]), labels


def split_scans(
    count: int, rng: np.random.Generator, test_share: float = 0.1, run: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Indices of training and test scans; `run` consecutive scans are held out together.

    Neighbouring scans see the same walls, so run = 1 (random scans) asks for interpolation and a longer run
    for views from places that were not visited.
    """
    if not 0 < test_share < 1 or not 1 <= run <= count * (1 - test_share):
        raise DataError(f"cannot hold out {test_share:g} of {count} scans in runs of {run}")
    blocks = rng.permutation(-(-count // run))
    wanted = max(1, round(test_share * count))
    test = np.concatenate([np.arange(b * run, min((b + 1) * run, count)) for b in blocks])[:wanted]
    return np.setdiff1d(np.arange(count), test), np.sort(test)


def _directions(poses: np.ndarray, angles: np.ndarray) -> np.ndarray:
    heading = poses[:, 2:3] + angles  # (S, B)
    return np.stack([np.cos(heading), np.sin(heading)], axis=-1)


def _select(log: LaserLog, scans: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    return (log.poses, log.ranges) if scans is None else (log.poses[scans], log.ranges[scans])


def _read_lines(path: Path) -> list[str]:
    if not path.is_file():
        raise DataError(f"{path}: no such log file")
    data = path.read_bytes()
    if data[:2] == b"\x1f\x8b":
        try:
            data = gzip.decompress(data)
        except (OSError, EOFError, zlib.error) as error:
            raise DataError(f"{path}: broken gzip file ({error}); fetch it again") from error
    return data.decode("ascii", errors="replace").splitlines()
