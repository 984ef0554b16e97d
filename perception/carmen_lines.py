"""Single laser lines of CARMEN logs. Knows the text of a line; must not know files or what a beam means."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

POSE_FIELDS = 6
"""Numbers after the ranges: laser x, y, yaw, then the odometry's (or the robot's) x, y, yaw."""
OLD_HEAD, NEW_HEAD = 2, 9
"""Words up to the first range of a FLASER line; of a ROBOTLASER1 line, which describes the laser first."""
NEW_TAIL = 5
"""Words of a ROBOTLASER1 line between its poses and its time: two speeds, two distances, an axis."""


@dataclass(frozen=True)
class LaserLine:
    """ranges (B,) [m], pose (3,) x, y [m], yaw [rad] of the laser, time [s], angles (B,) [rad] if it says."""

    ranges: np.ndarray
    pose: np.ndarray
    time: float
    angles: np.ndarray | None = None


def parse_flaser(line: str) -> LaserLine | None:
    """`FLASER count ranges x y yaw odom_x odom_y odom_yaw time ...`, or None when it is corrupt."""
    words = line.split()
    try:
        beams = int(words[1])
        numbers = np.array(words[OLD_HEAD : OLD_HEAD + beams + POSE_FIELDS], np.float64)
        time = float(words[OLD_HEAD + beams + POSE_FIELDS])
    except (ValueError, IndexError):
        return None
    if beams < 1 or numbers.size != beams + POSE_FIELDS or not _usable(numbers, beams):
        return None
    return LaserLine(numbers[:beams], numbers[beams : beams + 3], time)


def parse_robotlaser(line: str) -> LaserLine | None:
    """`ROBOTLASER1 type start_angle field_of_view resolution maximum_range accuracy mode count ranges
    remissions_count remissions laser_pose robot_pose ... time ...`, or None when it is corrupt."""
    words = line.split()
    try:
        start, _, resolution = (float(word) for word in words[2:5])
        beams = int(words[NEW_HEAD - 1])
        after = NEW_HEAD + beams
        remissions = int(words[after])
        poses = after + 1 + remissions
        numbers = np.array([*words[NEW_HEAD:after], *words[poses : poses + POSE_FIELDS]], np.float64)
        time = float(words[poses + POSE_FIELDS + NEW_TAIL])
    except (ValueError, IndexError):
        return None
    if beams < 1 or numbers.size != beams + POSE_FIELDS or not _usable(numbers, beams):
        return None
    angles = start + resolution * np.arange(beams)
    return LaserLine(numbers[:beams], numbers[beams : beams + 3], time, angles)


def _usable(numbers: np.ndarray, beams: int) -> bool:
    return bool(np.isfinite(numbers).all() and (numbers[:beams] >= 0).all())
