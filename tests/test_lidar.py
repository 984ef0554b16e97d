"""CARMEN logs: reading, corrupt lines, beam geometry, occupied and free points."""

from __future__ import annotations

import gzip

import numpy as np
import pytest

from mapping.errors import DataError
from perception.lidar import (
    BeamConfig,
    LaserLog,
    beam_angles,
    end_points,
    load_carmen,
    occupancy_samples,
    split_scans,
)


def flaser(ranges, pose=(1.0, 2.0, 0.5), time=7.0) -> str:
    numbers = [*ranges, *pose, *pose]
    return f"FLASER {len(ranges)} {' '.join(f'{n:g}' for n in numbers)} {time:g} host {time:g}"


GOOD = flaser([1.0, 2.0, 3.0, 4.0])


def write(path, lines, zipped=False):
    text = "\n".join(lines).encode()
    path.write_bytes(gzip.compress(text) if zipped else text)
    return path


@pytest.mark.parametrize("zipped", [False, True])
def test_reads_ranges_poses_and_times(tmp_path, zipped):
    lines = ["# comment", "ODOM 0 0 0", GOOD, flaser([4.0, 3.0, 2.0, 1.0], (0.0, 0.0, -1.0), 8.0)]
    log = load_carmen(write(tmp_path / "hall-corrected.log.gz", lines, zipped))
    assert log.name == "hall"
    assert log.corrupt_lines == 0
    np.testing.assert_allclose(log.ranges, [[1, 2, 3, 4], [4, 3, 2, 1]])
    np.testing.assert_allclose(log.poses, [[1, 2, 0.5], [0, 0, -1]])
    np.testing.assert_allclose(log.times, [7, 8])


@pytest.mark.parametrize(
    "broken",
    [
        "FLASER",
        "FLASER x 1 2 3",
        GOOD[:25],
        GOOD.replace("2 3", "nan 3"),
        GOOD.replace("2 3", "-2 3"),
        flaser([1.0, 2.0]),
    ],
    ids=["empty", "no count", "cut off", "nan", "negative", "other beam count"],
)
def test_corrupt_lines_are_counted_and_left_out(tmp_path, broken):
    log = load_carmen(write(tmp_path / "a.log", [GOOD, broken, GOOD]))
    assert log.corrupt_lines == 1
    assert log.ranges.shape == (2, 4)


def test_files_that_are_no_logs_are_refused(tmp_path):
    with pytest.raises(DataError, match="no such log"):
        load_carmen(tmp_path / "missing.log")
    with pytest.raises(DataError, match="no FLASER"):
        load_carmen(write(tmp_path / "text.log", ["hello"]))
    with pytest.raises(DataError, match="2 of 3"):
        load_carmen(write(tmp_path / "bad.log", [GOOD, "FLASER 1", "FLASER 2"]))
    (tmp_path / "cut.log.gz").write_bytes(gzip.compress(GOOD.encode() * 100)[:40])
    with pytest.raises(DataError, match="broken gzip"):
        load_carmen(tmp_path / "cut.log.gz")


def test_beam_angles_follow_the_logs_convention():
    assert beam_angles(180)[0] == pytest.approx(-np.pi / 2)
    assert beam_angles(180)[-1] == pytest.approx(np.pi / 2 - np.pi / 180)
    assert beam_angles(181)[-1] == pytest.approx(np.pi / 2)
    assert beam_angles(361)[180] == pytest.approx(0.0)


def square_room(scans: int, beams: int) -> LaserLog:
    """A laser in a square room of 8 m whose walls lie at +-4 m, at other places and headings."""
    rng = np.random.default_rng(3)
    poses = np.column_stack([rng.uniform(-3, 3, (scans, 2)), rng.uniform(-np.pi, np.pi, scans)])
    heading = poses[:, 2:] + beam_angles(beams)
    direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    walls = (4.0 * np.sign(direction) - poses[:, None, :2]) / direction
    return LaserLog("room", poses, walls.min(axis=2), np.arange(scans, dtype=float))


def test_end_points_lie_on_the_walls_and_free_points_before_them():
    log = square_room(20, 61)
    np.testing.assert_allclose(np.abs(end_points(log)).max(axis=-1), 4.0)
    X, y = occupancy_samples(log, np.random.default_rng(0))
    reach = np.abs(X).max(axis=1)
    np.testing.assert_allclose(reach[y == 1], 4.0)
    assert reach[y == 0].max() < 4.0
    expected = np.maximum(1, (log.ranges / 2.0).astype(int)).sum()
    assert (y == 1).sum() == log.ranges.size
    assert (y == 0).sum() == expected


def test_no_return_beams_are_dropped():
    log = LaserLog("one", np.zeros((1, 3)), np.array([[81.8, 5.0, 39.9]]), np.zeros(1))
    _, y = occupancy_samples(log, np.random.default_rng(0))
    assert (y == 1).sum() == 2
    _, y = occupancy_samples(log, np.random.default_rng(0), config=BeamConfig(range_max=10.0))
    assert (y == 1).sum() == 1


@pytest.mark.parametrize("run", [1, 7, 40])
def test_split_holds_out_a_tenth_without_overlap(run):
    train, test = split_scans(400, np.random.default_rng(1), run=run)
    assert len(test) == 40
    assert sorted([*train, *test]) == list(range(400))
    starts = 1 + (np.diff(test) > 1).sum()
    assert starts >= 20 if run == 1 else starts <= -(-40 // run) + 1


def test_split_refuses_what_cannot_be_held_out():
    with pytest.raises(DataError, match="cannot hold out"):
        split_scans(10, np.random.default_rng(0), run=11)
