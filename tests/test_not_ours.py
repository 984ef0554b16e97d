"""Data that is not ours stays: foreign files, other runs' results, recordings, scenes, mount points."""

from __future__ import annotations

import dataclasses
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from solids import reconstructed_tabletop

from mapping import folders
from mapping.errors import ConfigError, DataError
from mapping.files import is_temporary, temporary_beside, write_atomically
from mapping.folders import exchange, staged_folder
from mapping.locks import hold, release
from reconstruction.files.result_folder import check_output, load_result, save_reconstruction
from reconstruction.pictures.recording import check_recording
from tools.demo_folder import clear_scene, remember_scene
from tools.options import write_json
from tools.view import find_recording


@pytest.fixture(scope="module")
def one():
    """A reconstruction of one object: quick to save."""
    whole = reconstructed_tabletop()
    return dataclasses.replace(whole, objects=whole.objects[:1], fields=whole.fields[:1])


@pytest.fixture(scope="module")
def saved(one, tmp_path_factory) -> Path:
    return save_reconstruction(one, tmp_path_factory.mktemp("saved") / "result")


@pytest.fixture
def result(saved: Path, tmp_path: Path) -> Path:
    return shutil.copytree(saved, tmp_path / "result")


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of its own, empty."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64m", "tmpfs", str(folder)]
    if not shutil.which("mount") or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("a file system cannot be mounted here (needs root)")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


@pytest.mark.parametrize(
    "name",
    [
        "objects/9_mug/mesh.ply",
        *(
            pytest.param(n, marks=pytest.mark.slow)
            for n in ("notes.txt", "objects/mine.blend", "sub/data.csv")
        ),
    ],
)
def test_overwrite_keeps_what_is_not_the_results(one, result: Path, name: str) -> None:
    (result / name).parent.mkdir(exist_ok=True)
    (result / name).write_text("mine")
    with pytest.raises(ConfigError, match=name):
        check_output(result, overwrite=True)
    with pytest.raises(ConfigError, match=name):
        save_reconstruction(one, result, overwrite=True)
    assert (result / name).read_text() == "mine"
    (result / name).unlink()
    (result / ".DS_Store").touch()
    (result / "recording.rrd").touch()  # as `contramap view` leaves it
    save_reconstruction(one, result, overwrite=True)


def test_links_in_a_result_are_not_followed_nor_lost(one, result: Path, tmp_path: Path) -> None:
    (tmp_path / "treasure").mkdir()
    (tmp_path / "treasure" / "gold.txt").write_text("gold")
    (result / "link").symlink_to(tmp_path / "treasure")
    with pytest.raises(ConfigError, match="link"):
        save_reconstruction(one, result, overwrite=True)
    assert (tmp_path / "treasure" / "gold.txt").is_file()


def test_a_file_that_comes_while_the_work_goes_on_is_kept(one, result: Path, monkeypatch) -> None:
    from reconstruction.files import result_folder

    def slow_overview(reconstruction, path: Path, truth) -> None:
        (result / "late.txt").write_text("mine")
        path.touch()

    monkeypatch.setattr(result_folder, "draw_overview", slow_overview)
    before = (result / "scene.json").read_bytes()
    with pytest.raises(ConfigError, match=r"late\.txt"):
        save_reconstruction(one, result, overwrite=True)
    assert (result / "late.txt").read_text() == "mine"
    assert (result / "scene.json").read_bytes() == before


def test_of_two_writers_one_succeeds_and_the_other_is_told(tmp_path: Path) -> None:
    both = threading.Barrier(2)
    told: list[str] = []

    def write(content: str) -> None:
        try:
            with staged_folder(tmp_path / "out") as partial:
                (partial / "a.txt").write_text(content)
                both.wait(20)
        except ConfigError as error:
            told.append(str(error))

    writers = [threading.Thread(target=write, args=(name,)) for name in ("first", "second")]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert len(told) == 1
    assert "another run" in told[0]
    assert (tmp_path / "out" / "a.txt").read_text() in ("first", "second")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_there_is_no_moment_without_either_result(tmp_path: Path) -> None:
    """A kill between two renames would leave nothing: the names are exchanged in one step."""
    if not sys.platform.startswith("linux"):
        pytest.skip("only Linux exchanges names in one step")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "a.txt").write_text("0")
    stop, missing = threading.Event(), []

    def watch() -> None:
        while not stop.is_set():
            if not (tmp_path / "out" / "a.txt").exists():
                missing.append(time.monotonic())

    watcher = threading.Thread(target=watch)
    watcher.start()
    for number in range(100):
        with staged_folder(tmp_path / "out", lambda: None) as partial:
            (partial / "a.txt").write_text(str(number))
    stop.set()
    watcher.join()
    assert not missing
    assert (tmp_path / "out" / "a.txt").read_text() == "99"


def test_without_such_a_call_the_old_folder_is_moved_aside(result: Path, one, monkeypatch) -> None:
    monkeypatch.setattr(folders, "exchange", lambda a, b: False)
    save_reconstruction(one, result, overwrite=True)
    assert load_result(result).objects
    assert [path.name for path in result.parent.iterdir()] == ["result"]


def test_names_are_exchanged(tmp_path: Path) -> None:
    for name in "ab":
        (tmp_path / name).mkdir()
        (tmp_path / name / name).touch()
    if not exchange(tmp_path / "a", tmp_path / "b"):
        pytest.skip("this file system cannot")
    assert (tmp_path / "a" / "b").exists()
    with pytest.raises(FileNotFoundError):
        exchange(tmp_path / "a", tmp_path / "c")


def test_what_killed_runs_left_is_removed_and_what_others_do_is_not(tmp_path: Path) -> None:
    dead = tmp_path / ".out.0123456789ab.part"
    dead.mkdir()
    (dead / "mesh.ply").write_text("half")
    (tmp_path / ".out.0123456789ac.old").mkdir()
    (tmp_path / ".figures.json.0123456789ab.part").write_text("half")
    working = tmp_path / ".out.ffffffffffff.part"
    working.mkdir()
    others = [tmp_path / ".outer.0123456789ab.part", tmp_path / ".out.txt", tmp_path / ".out.zz.part"]
    for path in others:
        path.touch()
    lock = hold(working)
    with staged_folder(tmp_path / "out") as partial:
        (partial / "a").touch()
    write_atomically(tmp_path / "figures.json", b"{}")
    release(lock)
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {"out", "figures.json", working.name, *(path.name for path in others)}


def test_a_killed_map_leaves_nothing_after_the_next(tmp_path: Path) -> None:
    program = (
        "import sys, os, signal; from pathlib import Path; from mapping.folders import staged_folder\n"
        "with staged_folder(Path(sys.argv[1])) as partial:\n"
        "    (partial / 'a').touch(); os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", program, str(tmp_path / "out")], env=environment)
    assert [is_temporary(path) for path in tmp_path.iterdir()] == [True]
    with staged_folder(tmp_path / "out") as partial:
        (partial / "b").touch()
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_an_output_folder_that_is_a_mount_point_is_filled(one, disk: Path) -> None:
    check_output(disk)
    save_reconstruction(one, disk)
    assert load_result(disk).objects
    save_reconstruction(one, disk, overwrite=True)
    assert load_result(disk).objects
    assert not [path for path in disk.iterdir() if is_temporary(path)]


@pytest.mark.parametrize("exists", [pytest.param(True, marks=pytest.mark.slow), False])
def test_an_output_folder_on_another_disk_behind_a_link(
    one, disk: Path, tmp_path: Path, exists: bool
) -> None:
    """Behind a link. Nothing is written beside that, where it could not be renamed into place."""
    there = disk / "result"
    if exists:
        there.mkdir()
    (tmp_path / "out").symlink_to(there)
    save_reconstruction(one, tmp_path / "out")
    save_reconstruction(one, tmp_path / "out", overwrite=True)
    assert load_result(there).objects
    assert [path.name for path in disk.iterdir()] == ["result"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["disk", "out"]


def test_a_read_only_disk_is_said_before_the_work(one, saved: Path, disk: Path, monkeypatch) -> None:
    copy = shutil.copytree(saved, disk / "result")
    subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
    try:
        with pytest.raises(DataError, match="read-only"):
            check_output(disk / "new")
        with pytest.raises(DataError, match="may write to"):
            write_atomically(disk / "x.json", b"{}")
        pytest.importorskip("rerun", reason="rerun is not installed (extra `viz`)")
        # `view` falls back to a temporary folder.
        monkeypatch.setenv("TMPDIR", str(disk.parent))
        assert disk not in find_recording(copy).parents
    finally:
        subprocess.run(["mount", "-o", "remount,rw", str(disk)], check=True)


def test_a_clean_up_that_fails_does_not_hide_the_error(tmp_path: Path, monkeypatch) -> None:
    def refuse(self: Path, missing_ok: bool = False) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(Path, "unlink", refuse)
    with pytest.raises(DataError, match="No space"), temporary_beside(tmp_path / "x"):
        raise OSError(28, "No space left on device")


def test_links_in_a_circle_are_one_line(tmp_path: Path) -> None:
    (tmp_path / "a").symlink_to(tmp_path / "b")
    (tmp_path / "b").symlink_to(tmp_path / "a")
    with pytest.raises((ConfigError, DataError)):
        check_output(tmp_path / "a")
    with pytest.raises((ConfigError, DataError)):
        check_output(tmp_path / "a" / "out")


def test_a_file_in_the_way_is_said_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="not a folder"):
        check_output(tmp_path / "file" / "out")


def test_recordings_replace_recordings_only(tmp_path: Path) -> None:
    for name, content in (("old.rrd", b"RRF2...."), ("empty", b"")):
        (tmp_path / name).write_bytes(content)
        check_recording(tmp_path / name)
    check_recording(tmp_path / "new.rrd")
    (tmp_path / "depth.png").write_bytes(b"\x89PNG....")
    with pytest.raises(ConfigError, match="no rerun recording"):
        check_recording(tmp_path / "depth.png")
    with pytest.raises(ConfigError, match="folder"):
        check_recording(tmp_path)


def test_figures_replace_figures_only(tmp_path: Path) -> None:
    write_json({"a": 1}, tmp_path / "figures.json")
    write_json({"a": 2}, tmp_path / "figures.json")
    (tmp_path / "thesis.tex").write_text("years")
    with pytest.raises(ConfigError, match="no JSON"):
        write_json({"a": 2}, tmp_path / "thesis.tex")
    assert (tmp_path / "thesis.tex").read_text() == "years"


def test_a_demo_replaces_its_own_scene_only(tmp_path: Path) -> None:
    scene = tmp_path / "scene_0000"

    def make() -> None:
        scene.mkdir()
        (scene / "truth.json").write_text("{}")

    clear_scene(tmp_path, "scene_0000")
    make()
    with pytest.raises(ConfigError, match="another --out"):
        clear_scene(tmp_path, "scene_0000")  # of a data set
    remember_scene(tmp_path, scene)
    clear_scene(tmp_path, "scene_0000")
    assert not scene.exists()
    make()
    remember_scene(tmp_path, scene)
    (scene / "notes.txt").write_text("mine")
    with pytest.raises(ConfigError, match="another --out"):
        clear_scene(tmp_path, "scene_0000")
    assert (scene / "notes.txt").is_file()
