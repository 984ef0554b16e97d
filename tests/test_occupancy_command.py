"""`contramap occupancy`: the map files read back by hand, logs of other kinds, bad input, real logs."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from test_lidar import flaser, square_room

from mapping import load_map
from mapping.errors import DataError
from perception.carmen_lines import parse_robotlaser
from perception.laser_files import load_laser_log, longest_return
from perception.lidar import LaserLog
from tools.cli import main
from tools.occupancy.landscape import LandscapeConfig, spacings_for
from tools.occupancy.map_files import states

RADISH = Path(__file__).parents[1] / ".." / "shared" / "data" / "radish"


@pytest.fixture(scope="module")
def room(tmp_path_factory) -> tuple[Path, dict]:
    """A room's log mapped by the command: the output folder and the figures."""
    folder = tmp_path_factory.mktemp("room")
    log = square_room(40, 60)
    lines = [flaser(ranges, pose) for ranges, pose in zip(log.ranges, log.poses)]
    (folder / "room.log").write_text("\n".join(lines))
    arguments = ["occupancy", str(folder / "room.log"), "--out", str(folder / "out")]
    assert main([*arguments, "--json", str(folder / "room.json")]) == 0
    return folder / "out", json.loads((folder / "room.json").read_text())


def serve(folder: Path) -> tuple[np.ndarray, float, list[float]]:
    """The map as a map server makes it of the two files: 100 occupied, 0 free, -1 unknown, row 0 lowest."""
    yaml = pytest.importorskip("yaml")
    settings = yaml.safe_load((folder / "map.yaml").read_text())
    image = np.asarray(Image.open(folder / settings["image"]), float)
    p = image / 255 if settings["negate"] else (255 - image) / 255
    cells = np.full(p.shape, -1)
    cells[p > settings["occupied_thresh"]] = 100
    cells[p < settings["free_thresh"]] = 0
    return np.flipud(cells), settings["resolution"], settings["origin"]


def test_a_map_server_finds_walls_floor_and_the_unknown(room):
    cells, resolution, origin = serve(room[0])

    def at(x: float, y: float) -> int:
        return cells[int((y - origin[1]) / resolution), int((x - origin[0]) / resolution)]

    assert origin[2] == 0.0
    assert at(0.0, 0.0) == 0
    assert at(1.5, -2.0) == 0
    along = np.linspace(-3.5, 3.5, 30)
    walls = [at(4.0, y) for y in along] + [at(-4.0, y) for y in along] + [at(x, 4.0) for x in along]
    assert np.mean(np.array(walls) == 100) > 0.95
    assert at(4.45, 4.45) == -1  # behind the corner


def test_the_figures_say_what_was_found(room):
    figures = room[1]
    assert figures["auc"] > 0.98
    assert figures["scans"] == 40
    assert sum(figures["shares"].values()) == pytest.approx(1.0)
    tried = {float(key): value for key, value in figures["spacings_tried"].items()}
    assert tried[figures["spacing"]] == max(tried.values())


def test_probabilities_and_model_agree(room):
    with np.load(room[0] / "map.npz") as stored:
        probabilities, x, y = (stored[name] for name in ("probabilities", "x", "y"))
    model = load_map(room[0] / "contramap.npz")
    some = np.array([[10, 20], [60, 60], [100, 33]])
    asked = model.predict_proba(np.column_stack([x[some[:, 0]], y[some[:, 1]]]))
    np.testing.assert_allclose(probabilities[some[:, 0], some[:, 1]], asked, atol=2e-3)
    assert (room[0] / "map.png").stat().st_size > 1000


def test_same_seed_same_bytes_and_npz_logs_with_angles(room, tmp_path):
    log = square_room(40, 60)
    np.savez(tmp_path / "room.npz", poses=log.poses, ranges=log.ranges, angles=log.angles)
    for name in ("a", "b"):
        arguments = ["occupancy", str(tmp_path / "room.npz"), "--out", str(tmp_path / name)]
        assert main([*arguments, "--spacing", "0.5", "--resolution", "0.1"]) == 0
    for file in ("map.pgm", "map.yaml", "map.npz"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
    cells, resolution, _ = serve(tmp_path / "a")
    assert resolution == 0.1
    assert (cells == 0).sum() * 0.01 == pytest.approx(64, rel=0.15)  # the room's floor [m^2]


def test_readings_that_mean_no_return_are_found():
    log = square_room(30, 60)
    ranges = log.ranges.copy()
    ranges[:, ::7] = 29.9
    assert longest_return(replace(log, ranges=ranges)) < 29.9
    assert longest_return(log) == log.ranges.max()
    with pytest.raises(DataError, match="nothing was measured"):
        longest_return(LaserLog("dead", np.zeros((2, 3)), np.full((2, 4), np.inf), np.zeros(2)))


def test_spacings_grow_with_the_rooms():
    log = square_room(20, 60)
    hall = replace(log, ranges=log.ranges * 4)
    fine, coarse = (spacings_for(one, LandscapeConfig()) for one in (log, hall))
    np.testing.assert_allclose(np.array(coarse) / fine, 2.0, rtol=0.05)


def test_newer_carmen_lines_are_read(tmp_path):
    line = "ROBOTLASER1 0 -1.5 3.0 0.5 80 .01 0 4 1 2 3 4 2 7 7 1.5 2.5 0.1 1 2 0.1 0 0 .5 .2 9 55.5 me 5"
    scan = parse_robotlaser(line)
    np.testing.assert_allclose(scan.angles, [-1.5, -1.0, -0.5, 0.0])
    np.testing.assert_allclose(scan.pose, [1.5, 2.5, 0.1])
    assert scan.time == 55.5
    (tmp_path / "new.log").write_text("PARAM x\n" + "\n".join([line, line[:40], line, line]))
    log = load_laser_log(tmp_path / "new.log")
    assert log.corrupt_lines == 1
    np.testing.assert_allclose(log.angles, scan.angles)


def test_unsure_cells_are_unknown():
    p = np.array([[[0.9, 0.05, 0.05], [0.05, 0.9, 0.05], [0.3, 0.1, 0.6], [0.4, 0.4, 0.2]]])
    assert states(p, 0.5).tolist() == [[254, 0, 205, 205]]


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"poses": np.zeros((2, 3))}, "no array 'ranges'"),
        ({"poses": np.zeros((2, 3)), "ranges": np.ones((3, 5))}, "wanted poses"),
        ({"poses": np.full((2, 3), np.nan), "ranges": np.ones((2, 5))}, "finite pose"),
        ({"poses": np.zeros((2, 3)), "ranges": np.ones((2, 5)), "angles": np.zeros(4)}, "angles"),
    ],
)
def test_bad_npz_logs_are_one_clear_line(tmp_path, capsys, arrays, message):
    np.savez(tmp_path / "log.npz", **arrays)
    assert main(["occupancy", str(tmp_path / "log.npz"), "--out", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_used_folder_is_not_overwritten(room, capsys):
    log = str(room[0].parent / "room.log")
    assert main(["occupancy", log, "--out", str(room[0])]) == 2
    assert "--overwrite" in capsys.readouterr().err


def test_a_map_of_others_is_kept(room, tmp_path, capsys):
    (tmp_path / "map.pgm").write_text("of the robot")
    log = str(room[0].parent / "room.log")
    assert main(["occupancy", log, "--out", str(tmp_path), "--overwrite"]) == 2
    assert "is kept" in capsys.readouterr().err
    assert (tmp_path / "map.pgm").read_text() == "of the robot"


@pytest.mark.slow
@pytest.mark.skipif(not RADISH.is_dir(), reason="../shared/data/radish is absent: no real logs")
@pytest.mark.parametrize(("log", "table"), [("orebro", 0.9561), ("seattle", 0.9931)])
def test_real_logs_reach_the_table_without_configuration(tmp_path, log, table):
    file, figures = RADISH / f"{log}-corrected.log.gz", tmp_path / "figures.json"
    assert main(["occupancy", str(file), "--out", str(tmp_path / "out"), "--json", str(figures)]) == 0
    assert json.loads(figures.read_text())["auc"] > table - 0.002
