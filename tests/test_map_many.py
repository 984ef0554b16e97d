"""`contramap map` with several frames: one result each, bad frames reported, the others delivered."""

from __future__ import annotations

from pathlib import Path

import pytest

from mapping.errors import ConfigError
from perception.frame_io import save_frame
from tools.cli import main
from tools.map_many import result_folders


def test_folders_are_named_as_frames_are():
    frames = [Path("a/one"), Path("b/two.npz")]
    assert result_folders(frames, Path("out")) == [Path("out/one"), Path("out/two")]
    frames = [Path("a/frame"), Path("b/frame")]
    assert result_folders(frames, Path("out")) == [Path("out/a_frame"), Path("out/b_frame")]
    with pytest.raises(ConfigError, match="more than one would go to"):
        result_folders([Path("a/frame"), Path("a/frame")], Path("out"))


def test_a_bad_frame_does_not_stop_the_others(tabletop_frame, tmp_path, capsys):
    save_frame(tabletop_frame, tmp_path / "good")
    (tmp_path / "bad").mkdir()
    frames = [str(tmp_path / name) for name in ("bad", "good")]
    assert main(["map", *frames, "--out", str(tmp_path / "results")]) == 2
    said = capsys.readouterr()
    assert "bad: " in said.out
    assert "1 of 2 frames could not be mapped" in said.err
    assert [path.name for path in (tmp_path / "results").iterdir()] == ["good"]
    assert (tmp_path / "results" / "good" / "scene.json").is_file()
    assert main(["map", *frames, "--out", str(tmp_path / "results"), "--rrd", "x.rrd"]) == 2
    assert "one at a time" in capsys.readouterr().err
