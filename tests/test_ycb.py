"""Finding and reading scans, on a scan made here and on real ones where they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from mapping.errors import DataError
from sim_scenes.objects import ycb
from sim_scenes.objects.object_model import is_closed, load_model

SHARED = Path(__file__).resolve().parent.parent / "../shared/data/ycb"
OBJ = """mtllib textured.mtl
usemtl material_0
v 0 0 0
v 0.1 0 0
v 0 0.1 0
v 0 0 0.1
v 0 0 0
vt 0 0
vt 1 0
vt 0 1
f 1/1 3/2 2/3
f 5/3 2/2 4/1
f 1/1 4/2 3/3
f 2/1 3/2 4/3
"""


def make_scan(folder: Path, model_id: str = "001_tetrahedron") -> None:
    target = folder / model_id / "google_16k"
    target.mkdir(parents=True)
    (target / "textured.obj").write_text(OBJ)
    (target / "textured.mtl").write_text("newmtl material_0\nKd 1 1 1\nmap_Kd texture_map.png\n")
    Image.fromarray(np.full((4, 4, 3), (200, 10, 10), np.uint8)).save(target / "texture_map.png")


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A current folder, cache and repository without any scans around."""
    monkeypatch.delenv("YCB_DIR", raising=False)
    monkeypatch.setenv("CONTRAMAP_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(ycb, "REPOSITORY", tmp_path / "repository")
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    return tmp_path


def test_nothing_is_found_where_nothing_is(elsewhere: Path) -> None:
    assert ycb.find_ycb() is None


@pytest.mark.parametrize("place", ["shared/data/ycb", "cache/ycb"])
def test_usual_places_are_searched(elsewhere: Path, place: str) -> None:
    make_scan(elsewhere / place)
    found = ycb.find_ycb()
    assert found == (elsewhere / place).resolve()
    assert ycb.list_models(found) == ["001_tetrahedron"]


def test_argument_goes_before_environment_before_usual_places(
    elsewhere: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for place in ("given", "environment", "shared/data/ycb"):
        make_scan(elsewhere / place)
    monkeypatch.setenv("YCB_DIR", str(elsewhere / "environment"))
    assert ycb.find_ycb(elsewhere / "given") == elsewhere / "given"
    assert ycb.find_ycb() == elsewhere / "environment"


def test_a_named_folder_without_scans_is_an_error(elsewhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DataError, match="google_16k"):
        ycb.find_ycb(elsewhere)
    monkeypatch.setenv("YCB_DIR", str(elsewhere))
    with pytest.raises(DataError, match="YCB_DIR"):
        ycb.find_ycb()


def test_a_scan_is_read_with_its_texture_and_closed(tmp_path: Path) -> None:
    make_scan(tmp_path)
    model = ycb.load_ycb(tmp_path, "001_tetrahedron")
    assert len(model.mesh.vertices) == 4  # the vertex split by the texture seam is one again
    assert model.watertight
    assert model.texture is not None
    assert model.texture.reshape(-1, 3)[0].tolist() == [200, 10, 10]
    assert model.corner_uv is not None
    assert model.corner_uv.shape == (4, 3, 2)


def test_an_unknown_scan_names_those_that_exist(tmp_path: Path) -> None:
    make_scan(tmp_path)
    with pytest.raises(DataError, match="001_tetrahedron"):
        ycb.load_ycb(tmp_path, "024_bowl")


def test_open_and_touching_meshes_are_told_apart() -> None:
    cube = trimesh.creation.box()
    assert is_closed(cube)
    hole = trimesh.Trimesh(cube.vertices, cube.faces[1:], process=False)
    assert not is_closed(hole)
    # Two tetrahedra that share one edge: four triangles meet there, and yet the inside is well defined.
    vertices = [[0, 0, 0], [0, 0, 1], [1, 0, 0], [0.5, 1, 0], [-1, 0, 0], [-0.5, -1, 0]]
    pair = trimesh.Trimesh(
        vertices,
        [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2], [0, 1, 4], [0, 4, 5], [0, 5, 1], [1, 5, 4]],
        process=False,
    )
    assert not pair.is_watertight
    assert is_closed(pair)


def test_a_broken_mesh_file_is_an_error(tmp_path: Path) -> None:
    broken = tmp_path / "mesh.ply"
    broken.write_bytes(b"ply\nnot a mesh")
    with pytest.raises(DataError, match="mesh"):
        load_model(broken, "x", "ycb")
    with pytest.raises(DataError, match="no such"):
        load_model(tmp_path / "missing.obj", "x", "ycb")


@pytest.mark.skipif(not ycb.list_models(SHARED), reason="no real YCB scans in ../shared/data/ycb")
@pytest.mark.parametrize("model_id", ["003_cracker_box", "065-j_cups", "009_gelatin_box"])
def test_real_scans_bound_a_volume(model_id: str) -> None:
    model = ycb.load_ycb(SHARED, model_id)
    assert model.watertight
    assert model.connected
    assert model.texture is not None
    assert 0.02 < model.mesh.extents.max() < 0.4
