"""The result folder: complete or absent, safe names, and the same numbers when read back."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import subprocess

import numpy as np
import pytest
import trimesh
from solids import reconstructed_tabletop

from mapping.errors import ConfigError, DataError
from mapping.model_io import load_map
from perception.camera import invert_rigid, transform
from reconstruction.files.result_folder import check_output, save_reconstruction
from reconstruction.files.scene_json import NAME_LENGTH, object_folder, safe_name, to_json
from reconstruction.files.stored import load_result

HOSTILE_NAMES = (
    "../../etc/passwd",
    "/abs/path",
    "a\x00b",
    "..",
    "",
    "x" * 5000,
    "чашка",
    "con\nrol",
    "-rf",
    ".git",
)


@pytest.fixture(scope="module")
def reconstruction():
    return reconstructed_tabletop()


@pytest.fixture(scope="module")
def result(reconstruction, tmp_path_factory):
    return save_reconstruction(reconstruction, tmp_path_factory.mktemp("out") / "result")


def test_folder_holds_what_is_documented(result, reconstruction):
    files = {str(path.relative_to(result)) for path in result.rglob("*") if path.is_file()}
    meshes = {
        f"objects/{object_folder(item.label, item.name)}/mesh.{kind}"
        for item in reconstruction.objects
        for kind in ("ply", "obj")
    }
    frame = {f"frame/{name}" for name in ("depth.png", "rgb.png", "labels.png", "names.json", "camera.json")}
    assert files == meshes | frame | {"scene.json", "map.npz", "field.npz", "overview.png"}
    assert [path.name for path in result.parent.iterdir()] == ["result"]  # nothing temporary is left


def test_scene_json_says_what_was_done(result, reconstruction):
    scene = json.loads((result / "scene.json").read_text())
    assert scene["unit"] == "m"
    assert scene["seed"] == reconstruction.seed
    assert scene["config"]["map"] == reconstruction.config["map"]
    assert scene["timings_ms"].keys() == reconstruction.timings_ms.keys()
    assert scene["versions"]["numpy"] == np.__version__
    assert 0.5 < scene["support_plane"]["inlier_ratio"] <= 1
    for entry, item in zip(scene["objects"], reconstruction.objects, strict=True):
        assert (entry["label"], entry["name"], entry["watertight"]) == (item.label, item.name, True)
        assert entry["mean_uncertainty"] == pytest.approx(item.mean_uncertainty)
        np.testing.assert_allclose(entry["T_world_object"], item.T_world_object)
        assert (result / entry["mesh"]).is_file()
        assert (result / entry["mesh_obj"]).is_file()


def test_other_programs_read_the_ply_with_its_uncertainty(result, reconstruction):
    for item in reconstruction.objects:
        path = result / "objects" / object_folder(item.label, item.name) / "mesh.ply"
        mesh = trimesh.load(path, process=False)
        np.testing.assert_allclose(mesh.vertices, item.mesh.vertices, atol=1e-6)
        assert (mesh.faces == item.mesh.faces).all()
        assert mesh.is_watertight
        stored = mesh.metadata["_ply_raw"]["vertex"]["data"]["uncertainty"]
        np.testing.assert_allclose(stored, item.uncertainty, atol=1e-6)
        assert stored.min() >= 0
        assert stored.max() <= 1
        assert mesh.visual.vertex_colors.shape == (len(mesh.vertices), 4)


def test_open3d_reads_the_ply_and_trimesh_the_obj(result, reconstruction):
    import open3d as o3d

    item = reconstruction.objects[0]
    folder = result / "objects" / object_folder(item.label, item.name)
    tensor_mesh = o3d.t.io.read_triangle_mesh(str(folder / "mesh.ply"))
    np.testing.assert_allclose(tensor_mesh.vertex.positions.numpy(), item.mesh.vertices, atol=1e-6)
    obj = trimesh.load(folder / "mesh.obj", process=False)
    np.testing.assert_allclose(obj.vertices, item.mesh.vertices, atol=2e-6)
    assert (obj.faces == item.mesh.faces).all()


def test_map_and_fields_answer_as_before(result, reconstruction):
    points = reconstruction.samples[:200]
    np.testing.assert_allclose(
        load_map(result / "map.npz").predict_proba(points),
        reconstruction.map.predict_proba(points),
        atol=1e-6,
    )
    with np.load(result / "field.npz", allow_pickle=False) as stored:
        assert stored["labels"].tolist() == [item.label for item in reconstruction.objects]
        for label in stored["labels"]:
            uncertainty = stored[f"uncertainty_{label}"]
            # Amid the object: at its margin, objects that are not there are left out of the field.
            node = tuple(n // 2 for n in uncertainty.shape)
            assert uncertainty.dtype == np.float16
            assert uncertainty.shape == stored[f"occupancy_{label}"].shape
            place = stored[f"origin_{label}"] + stored[f"spacing_{label}"] * np.array(node)
            world = transform(stored["T_world_table"], place[None])
            assert uncertainty[node] == pytest.approx(reconstruction.query(world).uncertainty[0], abs=2e-3)


def test_load_result_gives_back_meshes_and_uncertainty(result, reconstruction):
    stored = load_result(result)
    for item, original in zip(stored.objects, reconstruction.objects, strict=True):
        assert (item.label, item.name) == (original.label, original.name)
        np.testing.assert_allclose(item.uncertainty, original.uncertainty, atol=1e-6)
        np.testing.assert_allclose(item.mesh.vertices, original.mesh.vertices, atol=1e-6)
        np.testing.assert_allclose(item.T_world_object, original.T_world_object)
        local = transform(invert_rigid(item.T_world_object), np.asarray(item.mesh.vertices))
        assert (np.abs(local) <= item.extents / 2 + 1e-4).all()


def test_same_reconstruction_gives_the_same_bytes(result, reconstruction, tmp_path):
    again = save_reconstruction(reconstruction, tmp_path / "again")
    for path in result.rglob("*"):
        if path.is_file():
            assert path.read_bytes() == (again / path.relative_to(result)).read_bytes(), path.name


@pytest.mark.parametrize("name", HOSTILE_NAMES)
def test_safe_names_are_one_harmless_component(name):
    safe = safe_name(name)
    assert 0 < len(safe) <= NAME_LENGTH
    assert safe.isascii()
    assert not set(safe) & set("/\\\x00\n: ")
    assert safe[0] not in ".-"


def test_hostile_names_stay_inside_the_folder(reconstruction, tmp_path):
    names = ("../../../escaped", "a\x00b/..", "x" * 5000, "чашка")
    objects = tuple(
        dataclasses.replace(item, name=name) for item, name in zip(reconstruction.objects, names, strict=True)
    )
    out = tmp_path / "deep" / "result"
    save_reconstruction(dataclasses.replace(reconstruction, objects=objects), out)
    assert [p.name for p in tmp_path.iterdir()] == ["deep"]
    assert [p.name for p in out.parent.iterdir()] == ["result"]
    assert len(list((out / "objects").iterdir())) == len(names)
    assert [item.name for item in load_result(out).objects] == [item.name for item in objects]


def test_output_folder_that_is_not_empty_is_kept(reconstruction, tmp_path):
    out = tmp_path / "mine"
    out.mkdir()
    (out / "thesis.txt").write_text("years of work")
    with pytest.raises(ConfigError, match="--overwrite"):
        save_reconstruction(reconstruction, out)
    with pytest.raises(ConfigError, match="not a result folder"):
        save_reconstruction(reconstruction, out, overwrite=True)
    (out / "scene.json").write_text('{"somebody": "else"}')
    with pytest.raises(ConfigError, match="not a result folder"):
        save_reconstruction(reconstruction, out, overwrite=True)
    assert (out / "thesis.txt").read_text() == "years of work"
    with pytest.raises(ConfigError, match="is a file"):
        check_output(out / "thesis.txt")


def test_overwrite_replaces_a_result_as_a_whole(result, reconstruction, tmp_path):
    out = tmp_path / "result"
    shutil.copytree(result, out)
    (out / "objects" / "99_gone").mkdir()
    one = dataclasses.replace(reconstruction, objects=reconstruction.objects[:1])
    with pytest.raises(ConfigError, match="--overwrite"):
        save_reconstruction(one, out)
    save_reconstruction(one, out, overwrite=True)
    assert len(list((out / "objects").iterdir())) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["result"]


def test_empty_folder_is_used(reconstruction, tmp_path):
    (tmp_path / "empty").mkdir()
    assert (save_reconstruction(reconstruction, tmp_path / "empty") / "scene.json").is_file()


def test_an_error_half_way_leaves_the_old_result(result, reconstruction, tmp_path):
    out = tmp_path / "result"
    shutil.copytree(result, out)
    before = {p: p.read_bytes() for p in out.rglob("*") if p.is_file()}
    broken = dataclasses.replace(reconstruction, config={"unserialisable": object()})
    with pytest.raises(TypeError):
        save_reconstruction(broken, out, overwrite=True)
    assert {p: p.read_bytes() for p in out.rglob("*") if p.is_file()} == before
    assert [p.name for p in tmp_path.iterdir()] == ["result"]


def test_a_full_disk_leaves_nothing_and_says_so(reconstruction, tmp_path):
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = os.name == "posix" and shutil.which("mount")
    if (
        not mounted
        or subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=400k", "tmpfs", str(disk)], capture_output=True
        ).returncode
    ):
        pytest.skip("a small file system cannot be mounted here (needs root)")
    try:
        with pytest.raises(DataError, match="free some space"):
            save_reconstruction(reconstruction, disk / "result", recording=True)
        assert list(disk.iterdir()) == []
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_a_file_size_limit_leaves_nothing_and_says_so(reconstruction, tmp_path):
    """The same path as a full disk, where no file system can be mounted."""
    resource = pytest.importorskip("resource", reason="needs POSIX limits")
    import signal

    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
    try:
        with pytest.raises(DataError, match="cannot write"):
            save_reconstruction(reconstruction, tmp_path / "result")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, handler)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda mesh: mesh.write_bytes(mesh.read_bytes()[:-100]), "cut short"),
        (lambda mesh: mesh.write_bytes(mesh.read_bytes()[:50]), "header"),
        (lambda mesh: mesh.write_bytes(b""), "header"),
        (lambda mesh: mesh.unlink(), "cannot read"),
    ],
)
def test_damaged_meshes_are_clear_errors(result, tmp_path, damage, message):
    out = shutil.copytree(result, tmp_path / "result")
    mesh = next(out.glob("objects/*/mesh.ply"))
    damage(mesh)
    with pytest.raises(DataError, match=message):
        load_result(out)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "not readable"),
        ("[]", "not a scene.json"),
        ('{"format": "contramap-result-1", "objects": [{}]}', "incomplete"),
        (
            '{"format": "contramap-result-1", "objects": [{"label": 1, "name": "a", "mesh": "../../x.ply"}]}',
            "leaves the result folder",
        ),
    ],
)
def test_damaged_scene_json_is_a_clear_error(tmp_path, content, message):
    (tmp_path / "scene.json").write_text(content)
    with pytest.raises(DataError, match=message):
        load_result(tmp_path)


def test_json_rows_stay_on_one_line_and_mean_the_same():
    content = {"T": [[1.0, -2e-9], [0.5, 3]], "names": ["a\n[ 1,\n 2 ]"], "none": None, "empty": []}
    text = to_json(content)
    assert json.loads(text) == content
    assert "[1.0, -2e-09]" in text
