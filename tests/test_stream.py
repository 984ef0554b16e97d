"""`contramap stream`: one map that grows, frame by frame; bad frames are skipped, stopped streams go on."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import make_tabletop

from mapping.errors import ConfigError
from perception.datasets.sequence import natural, shots_in
from perception.frame_io import save_frame
from reconstruction import load_result
from reconstruction.files import result_folder
from tools.cli import main

EYES = {2: (-0.55, 0.0, 0.5), 10: (0.6, 0.1, 0.5)}


def write_frames(folder: Path) -> Path:
    """Small frames of one table from two sides, and a broken one between them."""
    for number, eye in EYES.items():
        frame = make_tabletop(eye=eye, size=(120, 90), noise=0.001, seed=number).frame
        save_frame(frame, folder / f"frame_{number}")
    (folder / "frame_9").mkdir()
    return folder


@pytest.fixture(scope="module")
def grown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with frames/, the stream's result out/ and figures.json."""
    folder = tmp_path_factory.mktemp("stream")
    write_frames(folder / "frames")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(result_folder, "draw_overview", lambda r, path, truth: path.write_bytes(b"none"))
        words = ["stream", folder / "frames", "--out", folder / "out", "--json", folder / "figures.json"]
        assert main([*map(str, words)]) == 0
    return folder


def test_frames_come_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    for name in ("frame_10", "frame_2", "frame_1", ".hidden"):
        (tmp_path / name).mkdir()
    assert [shot.name for shot in shots_in(tmp_path)] == ["frame_1", "frame_2", "frame_10"]
    assert natural("a9b") < natural("a10a")
    with pytest.raises(ConfigError, match="holds no frame"):
        shots_in(tmp_path / "frame_1")


def test_a_frame_with_views_is_a_sequence(tmp_path: Path) -> None:
    frame = make_tabletop(size=(64, 48)).frame
    for place in (".", "views/2", "views/1"):
        save_frame(frame, tmp_path / "scene" / place)
    assert [shot.name for shot in shots_in(tmp_path / "scene")] == ["scene", "views/1", "views/2"]


def test_the_map_grows_and_the_bad_frame_is_skipped(grown: Path) -> None:
    figures = json.loads((grown / "figures.json").read_text())
    frames = figures["frames"]
    assert [one["name"] for one in frames] == ["frame_2", "frame_9", "frame_10"]
    assert [one["version"] for one in frames] == [1, 1, 2]
    assert "frame_9" in frames[1]["skipped"]
    assert all(frames[k]["skipped"] is None for k in (0, 2))
    assert frames[2]["uncertainty"] < frames[0]["uncertainty"]
    assert figures["mapped_now"] == 3
    assert figures["frames_per_second"] == pytest.approx(3 / figures["seconds"]["total"])


def test_the_result_is_one_of_several_views(grown: Path) -> None:
    stored = load_result(grown / "out")
    assert stored.scene["stream"]["version"] == 2
    assert len(stored.scene["views"]) == 2
    assert sorted(item.label for item in stored) == [1, 2, 3, 4]
    files = set(stored.scene["files"])
    assert {"overview.png", "field.npz", "map.npz", "recording.rrd"} <= files
    assert all((stored.folder / name).is_file() for name in files)
    assert not [path for path in grown.iterdir() if path.name.startswith(".")]


def test_the_recording_has_a_timeline_on_which_the_map_grows(grown: Path) -> None:
    from rerun.chunk import RrdReader

    recording = grown / "out" / "recording.rrd"
    reader = RrdReader(recording)
    assert len(reader.blueprints()) == 1
    chunks = list(reader.stream())
    name = next(item.name for item in load_result(grown / "out") if item.label == 1)
    rows = {}
    for entity in ("/progress/all", f"/world/uncertainty/1_{name}", "/world/camera/rgb", "/world/camera"):
        own = [c.to_record_batch() for c in chunks if c.entity_path == entity]
        rows[entity] = [number for batch in own for number in batch.column("frame").to_pylist()]
        assert sorted(set(rows[entity])) == [1, 3]
    unsure = {}
    for chunk in chunks:
        if chunk.entity_path == "/progress/all":
            batch = chunk.to_record_batch()
            values = [row.as_py()[0] for row in batch.column("Scalars:scalars")]
            unsure |= dict(zip(batch.column("frame").to_pylist(), values))
    assert unsure[3] < unsure[1]
    done = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "verify", str(recording)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def test_a_finished_stream_is_left_as_it_is(grown: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["stream", str(grown / "frames"), "--out", str(grown / "out")]
    before = (grown / "out" / "scene.json").read_bytes()
    assert main(words) == 0
    assert "3 frames were taken before" in capsys.readouterr().out
    assert main([*words, "--seed", "1"]) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert (grown / "out" / "scene.json").read_bytes() == before


@pytest.mark.slow
def test_a_stopped_stream_goes_on(
    grown: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(result_folder, "draw_overview", lambda r, path, truth: path.write_bytes(b"none"))
    frames, out = tmp_path / "frames", tmp_path / "out"
    frames.mkdir()
    shutil.copytree(grown / "frames" / "frame_2", frames / "frame_2")
    assert main(["stream", str(frames), "--out", str(out)]) == 0
    shutil.copytree(grown / "frames" / "frame_10", frames / "frame_10")
    capsys.readouterr()
    assert main(["stream", str(frames), "--out", str(out)]) == 0
    assert "going on with version 1" in capsys.readouterr().out
    scene = load_result(out).scene
    assert [one["name"] for one in scene["stream"]["frames"]] == ["frame_2", "frame_10"]
    assert scene["stream"]["version"] == 2
    assert len(scene["views"]) == 2


def test_what_is_not_a_streams_is_kept(
    grown: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    assert main(["stream", str(grown / "frames"), "--out", str(tmp_path)]) == 2
    assert "not empty" in capsys.readouterr().err
    assert (tmp_path / "mine.txt").read_text() == "mine"


def test_no_usable_frame_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a").mkdir()
    assert main(["stream", str(tmp_path)]) == 2
    said = capsys.readouterr()
    assert "none of 1 frames" in said.err
    assert "a: skipped" in said.out
