"""Frames that people really have (../shared/cases): meshes as files, in any world frame, and falling axes."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from mapping import ContraMap, MapConfig
from perception import load_frame
from reconstruction import reconstruct
from reconstruction.files import result_folder
from reconstruction.files.result_folder import load_result, save_reconstruction

CASES = Path(__file__).parents[2] / "shared" / "cases"
pytestmark = pytest.mark.skipif(not CASES.is_dir(), reason=f"no cases at {CASES}")


@pytest.fixture(autouse=True)
def no_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes most of the time and is no mesh."""
    monkeypatch.setattr(result_folder, "draw_overview", lambda r, path, truth: path.touch())


def files_of(folder: Path) -> dict[int, list[trimesh.Trimesh]]:
    """label -> its meshes as another program loads them; what scene.json says of them is checked."""
    entries = json.loads((folder / "scene.json").read_text())["objects"]
    assert all(entry["watertight"] for entry in entries)
    return {
        entry["label"]: [trimesh.load(folder / entry[key], force="mesh") for key in ("mesh", "mesh_obj")]
        for entry in entries
    }


def test_11_meshes_in_map_coordinates_have_their_volume(tmp_path: Path) -> None:
    """They were sheets: single precision has steps of half a metre there."""
    case = CASES / "11-pose-in-map-coordinates"
    result = reconstruct(load_frame(case / "frame"))
    folder = save_reconstruction(result, tmp_path / "result")
    truth = {item["label"]: item for item in json.loads((case / "case.json").read_text())["truth"]}
    origin = result.T_world_table[:3, 3]
    assert np.abs(origin).max() > 1e5
    stored = {item.label: item.mesh for item in load_result(folder).objects}
    found = files_of(folder)
    assert set(found) == set(truth)
    for label, meshes in found.items():
        low, high = np.array(truth[label]["bounds_m"])
        for mesh in (*meshes, stored[label]):
            assert mesh.is_volume
            # An object's own frame is as far away; taken off, its size and volume are those of the truth.
            near = trimesh.Trimesh(mesh.vertices - origin, mesh.faces, process=False)
            assert np.abs(near.extents - (high - low)).max() < 0.02
            assert 1e3 * near.volume == pytest.approx(truth[label]["volume_litres"], rel=0.25)


@pytest.mark.parametrize(
    ("name", "seed"), [("frame", 0), pytest.param("frame", 7, marks=pytest.mark.slow), ("frame_1km", 0)]
)
def test_13_what_is_closed_in_memory_is_closed_as_a_file(tmp_path: Path, name: str, seed: int) -> None:
    """Seeds 0 and 7, and every seed a kilometre away, left open files before."""
    result = reconstruct(load_frame(CASES / "13-mesh-file-not-watertight" / name), seed=seed)
    found = files_of(save_reconstruction(result, tmp_path / "result"))
    assert len(found) == 4
    assert all(mesh.is_volume for meshes in found.values() for mesh in meshes)


@pytest.mark.slow
def test_13_of_many_seeds(tmp_path: Path) -> None:
    """As case.json has it: seeds 0 to 7."""
    frame = load_frame(CASES / "13-mesh-file-not-watertight" / "frame")
    for seed in range(8):
        result = dataclasses.replace(reconstruct(frame, seed=seed), other=None)
        found = files_of(save_reconstruction(result, tmp_path / str(seed)))
        assert all(mesh.is_volume for meshes in found.values() for mesh in meshes)


def test_15_axes_may_fall() -> None:
    rng = np.random.default_rng(0)
    X = rng.uniform(-5, 5, (800, 2))
    y = (np.hypot(X[:, 0] - 1, 0.7 * X[:, 1]) < 2).astype(int)
    model = ContraMap(MapConfig(gamma=1.0)).fit(X, y)
    for steps in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        axes = [np.linspace(-5, 5, 41)[::step] for step in steps]
        lattice = model.predict_lattice(tuple(axes))
        points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
        single = model.predict_proba(points).reshape(lattice.shape)
        assert np.abs(lattice - single).max() < 1e-4
