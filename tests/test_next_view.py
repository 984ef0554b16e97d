"""The next view: what is hidden is worth looking at, what is in the way is seen to be."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import look_at, make_tabletop

from mapping.errors import ConfigError
from perception.camera import Camera, invert_rigid
from reconstruction import load_result, reconstruct
from reconstruction.files import result_folder
from reconstruction.looking import UncertainSpace, next_view, poses_around
from reconstruction.result import Reconstruction
from tools.cli import main

CAMERA = Camera(np.array([[150.0, 0, 79.5], [0, 150.0, 59.5], [0, 0, 1]]), 160, 120)


@pytest.fixture(scope="module")
def result() -> Reconstruction:
    return reconstruct(make_tabletop(size=(160, 120)).frame)


def test_the_other_side_is_worth_more_than_the_same(result: Reconstruction) -> None:
    poses = poses_around(result, 6)
    np.testing.assert_allclose(poses[0], result.frame.camera.T_world_camera, atol=1e-6)
    found = next_view(result, poses)
    assert found.best in (2, 3, 4)
    assert found.gains[3] > 1.3 * found.gains[0]
    assert (found.gains >= 0).all()
    assert (found.gains <= 1).all()
    assert sorted(found.order) == list(range(6))
    assert found.order[0] == found.best


def test_a_view_away_from_the_objects_is_worth_nothing(result: Reconstruction) -> None:
    away = look_at((-0.55, 0.0, 0.5), (-1.5, 0.0, 0.5))
    assert next_view(result, [away]).gains[0] == 0


def test_a_known_wall_hides_what_is_behind_it() -> None:
    """Half of the uncertain nodes lie behind a wall of nodes that are surely something."""
    known = np.zeros((20, 10, 10), np.float32)
    known[10] = 1
    x = np.repeat([4, 16], 5).astype(np.float32)
    points = np.stack([x, *np.tile(np.arange(3, 8), (2, 2)).astype(np.float32)], 1)
    space = UncertainSpace(np.zeros(3), 1.0, known, points, np.ones(10))
    before = invert_rigid(look_at((-60.0, 4.5, 4.5), (0.0, 4.5, 4.5)))
    assert space.gain(CAMERA, before) == pytest.approx(0.5)
    above = invert_rigid(look_at((10.0, 4.5, 80.0), (10.0, 4.6, 0.0)))
    assert space.gain(CAMERA, above) == pytest.approx(1.0)


def test_two_walls_that_may_be_there_hide_more_than_one() -> None:
    known = np.zeros((20, 10, 10), np.float32)
    known[8] = known[12] = 0.5
    points = np.array([[16, 4, 4], [10, 4, 4]], np.float32)
    before = invert_rigid(look_at((-60.0, 4.5, 4.5), (0.0, 4.5, 4.5)))
    for place, passing in zip(points, (0.25, 0.5)):
        space = UncertainSpace(np.zeros(3), 1.0, known, place[None], np.ones(1))
        assert space.gain(CAMERA, before) == pytest.approx(passing)


def test_what_a_view_has_shown_is_not_expected_again() -> None:
    """Of two uncertain groups left and right of a wall, the one that was looked at stays uncertain."""
    known = np.zeros((20, 10, 10), np.float32)
    known[10] = 1
    x = np.repeat([4, 16], 5).astype(np.float32)
    points = np.stack([x, *np.tile(np.arange(3, 8), (2, 2)).astype(np.float32)], 1)
    space = UncertainSpace(np.zeros(3), 1.0, known, points, np.ones(10))
    left, right = (invert_rigid(look_at((side, 4.5, 4.5), (10.0, 4.5, 4.5))) for side in (-60.0, 80.0))
    above = invert_rigid(look_at((10.0, 4.5, 80.0), (10.0, 4.6, 0.0)))
    after = space.seen_by(CAMERA, left)
    assert after.gain(CAMERA, left) == pytest.approx(0.0)
    assert after.gain(CAMERA, right) == pytest.approx(0.5)
    assert after.gain(CAMERA, above) == pytest.approx(0.5)
    assert after.seen_by(CAMERA, right).gain(CAMERA, above) == pytest.approx(0.0)


def test_the_views_of_a_map_are_worth_nothing_once_more(result: Reconstruction, tmp_path: Path) -> None:
    poses = poses_around(result, 6)
    both = result.update(make_tabletop(eye=poses[3][:3, 3], size=(160, 120)).frame)
    found = next_view(both, poses)
    assert found.gains[[0, 3]].max() < 0.3 * found.gains.max()
    result_folder.save_reconstruction(both, tmp_path / "map", whole=False)
    stored = next_view(load_result(tmp_path / "map"), poses)
    np.testing.assert_allclose(stored.gains, found.gains, atol=0.01)


def test_no_poses_are_refused(result: Reconstruction) -> None:
    with pytest.raises(ConfigError, match="poses"):
        next_view(result, [])


def test_look_from_the_command_line(
    result: Reconstruction,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Drawing takes most of the time.
    monkeypatch.setattr(result_folder, "draw_overview", lambda r, path, truth: path.write_bytes(b"none"))
    folder = result.save(tmp_path / "result")
    assert main(["look", str(folder), "--candidates", "6", "--json", str(tmp_path / "look.json")]) == 0
    written = json.loads((tmp_path / "look.json").read_text())
    found = next_view(result, poses_around(result, 6))
    assert written["best"] == found.best
    np.testing.assert_allclose([pose["gain"] for pose in written["poses"]], found.gains, atol=0.02)
    assert f"next view: pose {found.best}" in capsys.readouterr().out
    assert main(["look", str(folder), "--candidates", "0"]) == 2


def test_the_public_name_is_the_function() -> None:
    import contramap
    import reconstruction

    assert reconstruction.next_view is next_view
    assert contramap.next_view is next_view
    from reconstruction import next_view as again

    assert again is next_view
