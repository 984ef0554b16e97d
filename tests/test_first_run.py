"""What a new user does first: import the package, ask for its version, run the demo without pybullet."""

import importlib.util
import json
import re
import subprocess
import sys

import numpy as np
import pytest

import contramap
from perception import load_frame
from reconstruction.solid import Solid
from sim_scenes import shipped_scene
from sim_scenes.dataset import MIN_VISIBLE_PIXELS
from sim_scenes.truth import load_truth
from tools.cli import main


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return shipped_scene.unpack(tmp_path_factory.mktemp("shipped") / "scene")


def test_every_public_name_is_handed_on():
    for name in contramap.__all__:
        assert getattr(contramap, name) is not None
    assert set(contramap.__all__) <= set(dir(contramap))
    assert set(contramap._HOME) == set(contramap.__all__)
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = contramap.no_such_name


def test_importing_the_public_module_costs_nothing():
    code = (
        "import sys, contramap;"
        "heavy = {'numpy', 'torch', 'open3d', 'mapping'} & set(sys.modules);"
        "sys.exit(str(heavy) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_version(capsys):
    assert main(["--version"]) == 0
    text = capsys.readouterr().out
    assert re.fullmatch(r"contramap \d\S*\n", text)
    assert text.split()[1] == contramap.__version__


def test_the_shipped_scene_is_small_ours_and_true(scene):
    assert shipped_scene.SHIPPED.stat().st_size < 300_000
    frame, truth = load_frame(scene), load_truth(scene)
    assert frame.rgb is not None
    assert frame.labels is not None
    assert {item.source for item in truth.objects} == {"builtin"}
    assert {item.name for item in truth.objects} <= set(shipped_scene.FAMILIES)
    visible = np.bincount(frame.labels.ravel())
    for item in truth.objects:
        assert item.watertight
        assert visible[item.label] >= MIN_VISIBLE_PIXELS * shipped_scene.IMAGE_SCALE**2
        # The truth stands where the frame shows it: measured points lie on the mesh.
        seen = frame.labels == item.label
        points = frame.camera.rays[seen] * frame.depth[seen][:, None]
        T = frame.camera.T_world_camera
        world = points @ T[:3, :3].T + T[:3, 3]
        assert np.median(Solid(truth.meshes[item.label]).distance(world)) < 0.001


def test_demo_on_the_shipped_scene(tmp_path, capsys):
    figures = tmp_path / "figures.json"
    command = ["demo", "--objects", "shipped", "--out", str(tmp_path / "demo"), "--json", str(figures)]
    assert main(command) == 0
    assert "Chamfer" in capsys.readouterr().out
    result = tmp_path / "demo" / "result"
    assert (result / "overview.png").stat().st_size > 50_000
    rows = json.loads(figures.read_text())["objects"]
    assert len(rows) == len(load_truth(tmp_path / "demo" / "scene_0000").objects)
    assert np.mean([row["iou"] for row in rows]) > 0.4


def test_without_pybullet_the_demo_takes_the_shipped_scene(tmp_path, capsys, monkeypatch):
    find_spec = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util,
        "find_spec",
        lambda name, *rest: None if name == "pybullet" else find_spec(name, *rest),
    )
    from tools.demo import _scene

    scene = _scene(tmp_path, 0, "auto", None)
    assert "ships with the package" in capsys.readouterr().out
    assert load_truth(scene).objects


@pytest.mark.slow
def test_the_shipped_scene_can_be_made_again(tmp_path):
    pytest.importorskip("pybullet", reason="pybullet is not installed (extra `sim`, Python 3.10 or 3.11)")
    for name in ("a.zip", "b.zip"):
        shipped_scene.make(tmp_path / name)
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
