"""Objects are cut by processes: the same parts whatever their number, and one that dies costs its object
alone."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from itertools import chain
from pathlib import Path

import numpy as np
import pytest
import trimesh
from planner_scene import bracket, mug

from reconstruction.export import cut_process
from reconstruction.export.collision import CollisionConfig, convex_parts
from reconstruction.export.cut_process import CutFailedError, CutProcess
from reconstruction.export.cut_worker import begin, pack_groups, unpack_groups
from reconstruction.export.export_scene import ExportConfig, ExportScene
from reconstruction.solid import Solid


@pytest.fixture(autouse=True)
def nothing_kept(tmp_path, monkeypatch):
    monkeypatch.setenv("CONTRAMAP_CACHE", str(tmp_path / "cache"))


def corners(found) -> list[bytes]:
    return [np.asarray(part.vertices).tobytes() for of_one in found for part in of_one.parts]


def test_the_number_of_processes_changes_no_byte(tmp_path, monkeypatch):
    meshes = [bracket(), mug(), trimesh.creation.box((0.1, 0.2, 0.05))]
    seen: list[int] = []
    alone = convex_parts(meshes, done=lambda: seen.append(1), workers=1)
    monkeypatch.setenv("CONTRAMAP_CACHE", str(tmp_path / "other"))
    together = convex_parts(meshes, workers=3)
    assert corners(alone) == corners(together)
    assert corners(convex_parts(meshes, workers=3)) == corners(alone)  # now from the cache
    assert len(seen) == len(meshes)


def test_coacd_may_make_the_first_cuts():
    pytest.importorskip("coacd")
    for found in convex_parts([mug(), bracket()], CollisionConfig(cutter="coacd")):
        assert found.note == ""
        assert len(found.parts) >= 3
        assert found.error_m < 3e-3


def test_what_takes_too_long_becomes_its_hull_and_says_so(tmp_path):
    (found,) = convex_parts([mug()], CollisionConfig(time_limit_s=0.0))
    assert len(found.parts) == 1
    assert found.excess_m > 0.02
    assert "took too long" in found.note
    assert not list(tmp_path.rglob("*.npz"))  # the next run tries again


def test_a_process_that_dies_costs_one_object_at_most(tmp_path, monkeypatch):
    """Once: the object is cut again. Each time: it becomes its hull, and the other is cut as ever."""
    killed: list[int] = []
    begun = CutProcess.begin

    def killing(self, mesh, settings, limit_s):
        if len(mesh.faces) == len(mug().faces) and len(killed) < times:
            process = self._started()
            os.kill(process.pid, signal.SIGSEGV)
            process.wait()
            killed.append(process.pid)
        return begun(self, mesh, settings, limit_s)

    (whole, other) = convex_parts([mug(), bracket()])
    monkeypatch.setattr(CutProcess, "begin", killing)
    for times, parts in ((1, len(whole.parts)), (9, 1)):
        killed.clear()
        monkeypatch.setenv("CONTRAMAP_CACHE", str(tmp_path / str(times)))
        (found, beside) = convex_parts([mug(), bracket()], workers=2)
        assert len(found.parts) == parts
        assert ("signal 11" in found.note) == (parts == 1)
        assert corners([beside]) == corners([other])
        assert len(killed) == min(times, 2)


def test_a_death_between_two_cuts_is_noticed():
    process = CutProcess()
    process.begin(mug(), {"coacd": None, "simplify": 0.001}, 60)
    process._started().kill()
    with pytest.raises(CutFailedError, match="signal 9"):
        process.halve([0], np.zeros((1, 3)))
    assert len(process.begin(mug(), {"coacd": None, "simplify": 0.001}, 60)) == 1  # by a new one
    process.close()


def test_without_any_process_the_parts_are_the_same(tmp_path, monkeypatch):
    usual = convex_parts([mug()])
    monkeypatch.setenv("CONTRAMAP_CACHE", str(tmp_path / "other"))
    monkeypatch.setattr(cut_process.sys, "executable", str(tmp_path / "no python"))
    assert corners(convex_parts([mug()])) == corners(usual)


def test_a_script_without_a_main_guard_exports(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        "import trimesh\n"
        "from reconstruction.export.collision import convex_parts\n"
        "bent = trimesh.creation.box((0.08, 0.02, 0.02)).union(\n"
        "    trimesh.creation.box((0.02, 0.02, 0.06)).apply_translation((0.03, 0, 0.03)))\n"
        "print('parts', len(convex_parts([bent], workers=2)[0].parts))\n"
    )
    paths = os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    run = subprocess.run(
        [sys.executable, str(script)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": paths},
        check=False,
    )
    assert run.stdout.startswith("parts "), run.stderr
    assert int(run.stdout.split()[1]) >= 2


def test_simplified_bodies_stay_closed_and_near():
    ball = trimesh.creation.icosphere(4, 0.05)
    settings = {"coacd": None, "simplify": 1e-3}
    ((vertices, _),) = begin(ball.vertices, ball.faces, settings).hulls
    assert len(vertices) < len(ball.vertices) / 3
    assert np.abs(np.linalg.norm(vertices, axis=1) - 0.05).max() < 1e-3
    torn = begin(ball.vertices, ball.faces[:-3], settings)
    (hull,) = torn.hulls
    assert Solid(trimesh.Trimesh(*hull)).inside(np.zeros((1, 3), np.float32)).all()
    assert torn.halve([0], np.zeros((1, 3))) == [[]]


def test_messages_hold_groups_of_meshes_none_of_them_too_small():
    one = (np.arange(12.0).reshape(4, 3), np.arange(6).reshape(2, 3))
    other = (np.ones((3, 3)), np.zeros((1, 3), np.int64))
    for groups in ([], [[]], [[one, other], [], [other]]):
        found = unpack_groups(pack_groups(groups)[8:])
        assert [len(group) for group in found] == [len(group) for group in groups]
        for mine, theirs in zip(chain(*found), chain(*groups)):
            assert all(np.array_equal(a, b) for a, b in zip(mine, theirs))


def test_settings_are_checked(tmp_path):
    from mapping.errors import ConfigError

    for wrong in ({"workers": 0}, {"cutter": "saw"}):
        with pytest.raises(ConfigError, match=next(iter(wrong))):
            ExportScene(None, ExportConfig(**wrong))
