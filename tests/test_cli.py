"""The command line end to end: help, results, and bad input as one line and exit code 2."""

import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import make_tabletop

from perception import save_frame
from reconstruction import load_result
from tools.cli import COMMANDS, GROUPS, main

SIZE = (240, 180)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("frame")
    save_frame(make_tabletop(size=SIZE).frame, path)
    return path


@pytest.fixture
def copy(folder, tmp_path) -> Path:
    """A frame folder that a test may damage."""
    import shutil

    return Path(shutil.copytree(folder, tmp_path / "frame"))


def fails(capsys, *arguments: object) -> str:
    """Run a command that must fail with exit code 2 and one line; returns the line."""
    capsys.readouterr()
    code = main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    assert code == 2, out + err
    lines = [line for line in err.splitlines() if line]
    assert len(lines) == 1, err
    assert lines[0].startswith("contramap: error: ")
    return lines[0]


def test_map_writes_the_whole_result_folder(folder, tmp_path):
    assert main(["map", str(folder), "--out", str(tmp_path / "r"), "--rrd", str(tmp_path / "run.rrd")]) == 0
    names = {path.name for path in (tmp_path / "r").iterdir()}
    assert {"scene.json", "objects", "map.npz", "field.npz", "overview.png"} <= names
    scene = json.loads((tmp_path / "r" / "scene.json").read_text())
    assert scene["config"]["preset"] == "tabletop"
    stored = load_result(tmp_path / "r")
    assert all(item.mesh.is_watertight for item in stored.objects)
    assert (tmp_path / "run.rrd").stat().st_size > 10_000


def test_map_from_separate_files_and_from_npz(folder, tmp_path):
    camera = json.loads((folder / "camera.json").read_text())
    K = np.array(camera["K"])
    numbers = [str(v) for v in (K[0, 0], K[1, 1], K[0, 2], K[1, 2])]
    files = ["--rgb", folder / "rgb.png", "--depth", folder / "depth.png", "--labels", folder / "labels.png"]
    scale = ["--intrinsics", *numbers, "--depth-scale", camera["depth_scale"]]
    out = tmp_path / "separate"
    assert main([str(a) for a in ["map", *files, *scale, "--out", out]]) == 0
    depth = cv2.imread(str(folder / "depth.png"), -1) * np.float32(camera["depth_scale"])
    labels = cv2.imread(str(folder / "labels.png"), -1)
    np.savez(tmp_path / "frame.npz", depth=depth, K=K, segmap=labels)
    assert main(["map", str(tmp_path / "frame.npz"), "--out", str(tmp_path / "npz")]) == 0
    a, b = load_result(out), load_result(tmp_path / "npz")
    for one, other in zip(a.objects, b.objects, strict=True):
        np.testing.assert_allclose(one.mesh.vertices, other.mesh.vertices, atol=1e-6)


def test_the_configuration_of_a_result_can_be_used_again(folder, tmp_path):
    out = tmp_path / "first"
    assert main(["map", str(folder), "--out", str(out), "--set", "samples.pair_offset=0.006"]) == 0
    config = json.loads((out / "scene.json").read_text())["config"]
    assert config["samples"]["pair_offset"] == 0.006
    (tmp_path / "config.json").write_text(json.dumps(config))
    again = tmp_path / "again"
    assert main(["map", str(folder), "--out", str(again), "--config", str(tmp_path / "config.json")]) == 0
    for a, b in zip(load_result(out).objects, load_result(again).objects, strict=True):
        np.testing.assert_array_equal(a.mesh.vertices, b.mesh.vertices)


def test_output_folder_must_be_empty_unless_overwrite(folder, tmp_path, capsys):
    out = tmp_path / "r"
    assert main(["map", str(folder), "--out", str(out)]) == 0
    before = (out / "scene.json").read_bytes()
    assert "--overwrite" in fails(capsys, "map", folder, "--out", out)
    assert (out / "scene.json").read_bytes() == before
    assert main(["map", str(folder), "--out", str(out), "--overwrite", "--seed", "3"]) == 0
    assert json.loads((out / "scene.json").read_text())["seed"] == 3


@pytest.mark.slow
def test_a_full_disk_leaves_nothing_half_written(folder, tmp_path):
    code = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "from tools.cli import main; resource.setrlimit(resource.RLIMIT_FSIZE, (60000, 60000));"
        f"sys.exit(main(['map', {str(folder)!r}, '--out', {str(tmp_path / 'r')!r}]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2, done.stderr
    assert done.stderr.count("contramap: error:") == 1
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def replace_json(path: Path, **changes: object) -> None:
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


def damage_no_depth(folder: Path) -> None:
    (folder / "depth.png").unlink()


def damage_truncated_rgb(folder: Path) -> None:
    content = (folder / "rgb.png").read_bytes()
    (folder / "rgb.png").write_bytes(content[: len(content) // 3])


def damage_label_size(folder: Path) -> None:
    cv2.imwrite(str(folder / "labels.png"), np.ones((7, 9), np.uint16))


def damage_rgb_size(folder: Path) -> None:
    cv2.imwrite(str(folder / "rgb.png"), np.zeros((7, 9, 3), np.uint8))


def damage_colour_labels(folder: Path) -> None:
    colours = np.ones((SIZE[1], SIZE[0], 3), np.uint8) * np.array([1, 2, 3], np.uint8)
    cv2.imwrite(str(folder / "labels.png"), colours)


def damage_no_labelled_pixel(folder: Path) -> None:
    cv2.imwrite(str(folder / "labels.png"), np.zeros((SIZE[1], SIZE[0]), np.uint16))


def damage_zero_depth(folder: Path) -> None:
    cv2.imwrite(str(folder / "depth.png"), np.zeros((SIZE[1], SIZE[0]), np.uint16))


def damage_nan_depth(folder: Path) -> None:
    (folder / "depth.png").unlink()
    np.save(folder / "depth.npy", np.full((SIZE[1], SIZE[0]), np.nan, np.float32))


def damage_millimetres_as_metres(folder: Path) -> None:
    replace_json(folder / "camera.json", depth_scale=1.0)


def damage_metres_as_millimetres(folder: Path) -> None:
    replace_json(folder / "camera.json", depth_scale=1e-6)


def damage_nan_K(folder: Path) -> None:
    replace_json(folder / "camera.json", K=[[float("nan"), 0, 1], [0, 1, 1], [0, 0, 1]])


def damage_negative_focal_length(folder: Path) -> None:
    replace_json(folder / "camera.json", K=[[-200, 0, 120], [0, 200, 90], [0, 0, 1]])


def damage_principal_point(folder: Path) -> None:
    replace_json(folder / "camera.json", K=[[200, 0, 1200], [0, 200, 90], [0, 0, 1]])


def damage_pose(folder: Path) -> None:
    replace_json(folder / "camera.json", T_world_camera=np.diag([2.0, 2, 2, 1]).tolist())


@pytest.mark.parametrize(
    ("damage", "word"),
    [
        (damage_no_depth, "depth"),
        (damage_truncated_rgb, "rgb"),
        (damage_label_size, "labels"),
        (damage_rgb_size, "rgb"),
        (damage_colour_labels, "labels"),
        (damage_no_labelled_pixel, "no labelled pixel"),
        (damage_zero_depth, "empty"),
        (damage_nan_depth, "empty"),
        (damage_millimetres_as_metres, "depth_scale"),
        (damage_metres_as_millimetres, "depth_scale"),
        (damage_nan_K, "NaN"),
        (damage_negative_focal_length, "focal"),
        (damage_principal_point, "principal point"),
        (damage_pose, "rigid"),
    ],
)
def test_a_damaged_frame_is_one_clear_line(copy, tmp_path, capsys, damage, word):
    damage(copy)
    assert word in fails(capsys, "map", copy, "--out", tmp_path / "r")
    assert not (tmp_path / "r").exists()


def test_wrong_arguments_are_one_clear_line(folder, tmp_path, capsys):
    out = ["--out", tmp_path / "r"]
    assert "no such" in fails(capsys, "map", tmp_path / "absent", *out).lower()
    assert "paper, tabletop" in fails(capsys, "map", folder, *out, "--preset", "best")
    assert "spacing" in fails(capsys, "map", folder, *out, "--set", "mesh.spacin=0.1")
    assert "section.field=value" in fails(capsys, "map", folder, *out, "--set", "mesh.spacing")
    assert "--intrinsics" in fails(capsys, "map", "--depth", folder / "depth.png", *out)
    assert "FRAME" in fails(capsys, "map", *out)
    assert "device" in fails(capsys, "map", folder, *out, "--device", "abacus")
    assert not (tmp_path / "r").exists()


def test_a_pickled_npz_is_refused(tmp_path, capsys):
    np.savez(tmp_path / "evil.npz", depth=np.array([{"a": 1}], dtype=object), K=np.eye(3))
    assert "pickle" in fails(capsys, "map", tmp_path / "evil.npz", "--out", tmp_path / "r").lower()


def test_an_object_name_cannot_leave_the_result_folder(copy, tmp_path):
    (copy / "names.json").write_text(json.dumps({"1": "../../../escape", "2": "a/b\\c"}))
    assert main(["map", str(copy), "--out", str(tmp_path / "r")]) == 0
    root = (tmp_path / "r").resolve()
    for path in tmp_path.rglob("*"):
        assert path.resolve().is_relative_to(tmp_path.resolve())
    scene = json.loads((root / "scene.json").read_text())
    assert {item["name"] for item in scene["objects"]} >= {"../../../escape"}
    for item in load_result(root).objects:
        assert item.folder.resolve().is_relative_to(root)


def test_latency_benchmark_writes_its_figures(folder, tmp_path):
    path = tmp_path / "latency.json"
    assert main(["benchmark", "latency", "--frame", str(folder), "--repeat", "2", "--json", str(path)]) == 0
    figures = json.loads(path.read_text())
    assert {"total_ms", "stages_ms", "peak_rss_mb", "objects", "threads"} <= set(figures)
    assert {"load", "space", "samples", "fit", "field", "mesh"} <= set(figures["stages_ms"])
    assert figures["objects"] == 4


@pytest.mark.parametrize(
    "command", [[], *[[c] for c in COMMANDS], *[[g, c] for g in GROUPS for c in GROUPS[g]]]
)
def test_help_exits_0_and_needs_no_heavy_import(command, capsys):
    with pytest.raises(SystemExit) as exit_code:
        main([*command, "--help"])
    assert exit_code.value.code == 0
    text = capsys.readouterr().out
    assert "usage" in text
    if command and command[0] not in GROUPS:
        assert "Example" in text


def test_an_unknown_command_exits_with_2(capsys):
    assert "mapp" in fails(capsys, "mapp")
    assert "--bogus" in fails(capsys, "map", "FRAME", "--out", "unused", "--bogus")


def test_importing_the_command_line_is_light():
    code = (
        "import sys, tools.cli;"
        "heavy = {'torch', 'open3d', 'pybullet', 'rerun', 'matplotlib'} & set(sys.modules);"
        "sys.exit(str(heavy) if heavy else 0)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, env=dict(os.environ)
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("message", "package", "advice"),
    [
        ("libusb-1.0.so.0: cannot open shared object file", "open3d", "apt-get install"),
        ("No module named 'pybullet'", "pybullet", "3.10 and 3.11"),
        ("No module named 'rerun'", "rerun", "contramap[viz]"),
    ],
)
def test_a_missing_library_is_one_line_with_the_mend(monkeypatch, capsys, message, package, advice):
    import tools.cli

    def broken(arguments: list[str]) -> None:
        raise ImportError(message, name=package)

    monkeypatch.setattr(tools.cli, "_run", broken)
    line = fails(capsys, "map")
    assert message in line
    assert advice in line


@pytest.mark.parametrize("command", [["tools.real_frames", "--data"], ["tools.ablation", "--out", "unused"]])
def test_modules_that_are_commands_say_what_is_wrong_in_one_line(command, tmp_path):
    run = [sys.executable, "-m", *command, str(tmp_path / "nowhere")]
    done = subprocess.run(run, cwd=Path(__file__).parents[1], capture_output=True, text=True)
    assert done.returncode == 2
    assert "nowhere" in done.stderr
    assert "Traceback" not in done.stderr
