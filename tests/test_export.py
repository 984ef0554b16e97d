"""Exports as folders: complete or absent, stated in words, refused in one line; and the convex parts they
share."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
import trimesh
from planner_scene import MUG_HEIGHT, PlannerScene, bracket, mug, planner_scene

from mapping.errors import ConfigError, DataError
from reconstruction.export.collision import convex_parts
from reconstruction.export.cut_process import CutProcess
from reconstruction.export.export_scene import ExportConfig, ExportScene
from reconstruction.export.formats import FORMATS, export
from reconstruction.export.hulls import convex_hull
from reconstruction.export.parts_error import parts_error
from reconstruction.files.mesh_files import encode_ply
from reconstruction.files.result_folder import load_result, save_reconstruction
from tools.cli import main

QUICK = ("obj", "glb", "curobo", "gpd", "contact-graspnet")


@pytest.fixture(scope="module")
def planned(tmp_path_factory) -> PlannerScene:
    return planner_scene(tmp_path_factory.mktemp("result"))


def test_every_folder_states_frame_unit_and_quaternion(planned, tmp_path):
    folders = export(planned.scene(), list(FORMATS), tmp_path)
    assert [folder.name for folder in folders] == list(FORMATS)
    for folder in folders:
        said = json.loads((folder / "export.json").read_text())
        assert "frame" in said["frame"] or "camera" in said["frame"]
        assert said["unit"].startswith("m")
        assert said["quaternion"]
        assert said["objects"]["1_mug"] == {"label": 1, "name": "mug"}
        assert len(said["files"]) >= 1
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_the_same_result_gives_the_same_bytes(planned, tmp_path):
    for place in ("a", "b"):
        export(planned.scene(), [name for name in FORMATS if name != "moveit"], tmp_path / place)
    for path in (tmp_path / "a").rglob("*"):
        if path.is_file():
            other = tmp_path / "b" / path.relative_to(tmp_path / "a")
            assert path.read_bytes() == other.read_bytes(), path.name


def test_an_older_export_is_kept_unless_asked(planned, tmp_path):
    export(planned.scene(), ["obj"], tmp_path)
    with pytest.raises(ConfigError, match="--overwrite"):
        export(planned.scene(), ["obj"], tmp_path)
    export(planned.scene(), ["obj"], tmp_path, overwrite=True)
    (tmp_path / "obj" / "extra.txt").write_text("mine")
    with pytest.raises(ConfigError, match=r"extra\.txt"):
        export(planned.scene(), ["obj"], tmp_path, overwrite=True)
    assert (tmp_path / "obj" / "extra.txt").read_text() == "mine"


def test_a_folder_of_others_is_never_replaced(planned, tmp_path):
    (tmp_path / "obj").mkdir()
    (tmp_path / "obj" / "thesis.txt").write_text("years of work")
    with pytest.raises(ConfigError, match="not written by an export"):
        export(planned.scene(), ["obj"], tmp_path, overwrite=True)
    assert (tmp_path / "obj" / "thesis.txt").read_text() == "years of work"


def test_an_error_half_way_leaves_nothing(planned, tmp_path, monkeypatch):
    def broken(scene, folder):
        (folder / "half.obj").write_text("v 0 0 0")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("reconstruction.export.plain_meshes.write", broken)
    with pytest.raises(DataError, match="free some space"):
        export(planned.scene(), ["obj"], tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "settings", [{"density": 0.0}, {"density": -1.0}, {"inflate": 1.5}, {"inflate": 0.0}]
)
def test_senseless_settings_are_refused(planned, settings):
    with pytest.raises(ConfigError):
        ExportScene(planned.result, ExportConfig(**settings))


def test_command_writes_from_a_result_alone(tabletop_frame, tmp_path, capsys):
    from solids import reconstructed_tabletop

    save_reconstruction(reconstructed_tabletop(), tmp_path / "result")
    arguments = ["export", str(tmp_path / "result"), "--out", str(tmp_path / "out"), "--format"]
    assert main([*arguments, *QUICK, "--json", str(tmp_path / "figures.json")]) == 0
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(QUICK)
    assert json.loads((tmp_path / "figures.json").read_text())["objects"] == 4
    capsys.readouterr()
    assert main([*arguments, "step"]) == 2
    assert "valid: obj, glb, urdf" in capsys.readouterr().err
    assert main(["export", str(tmp_path), "--out", str(tmp_path / "x"), "--format", "obj"]) == 2
    assert "not a result folder" in capsys.readouterr().err


def test_obstacles_without_a_label_reach_planners(planned, tmp_path):
    result = dataclasses.replace(planned.result, scene={**planned.result.scene, "other": {"faces": 12}})
    box = trimesh.creation.box((0.05, 0.05, 0.3))
    box.apply_translation([0.2, 0.3, 1.2])
    place = planned.result.folder / "objects" / "other"
    place.mkdir(parents=True)
    (place / "mesh.ply").write_bytes(encode_ply(box, np.ones(len(box.vertices))))
    export(ExportScene(result), ["obj", "curobo", "moveit"], tmp_path)
    found = trimesh.load(tmp_path / "obj" / "other.obj", process=False)
    assert found.bounds == pytest.approx(box.bounds, abs=1e-5)
    for path in ("curobo/world_mesh.yml", "moveit/planning_scene.yaml"):
        assert '"other"' in (tmp_path / path).read_text()


def test_result_keeps_the_frame(tmp_path):
    from solids import reconstructed_tabletop

    reconstruction = reconstructed_tabletop()
    stored = load_result(save_reconstruction(reconstruction, tmp_path / "result"))
    frame = stored.frame()
    measured = np.isfinite(reconstruction.frame.depth)
    assert np.abs(frame.depth - reconstruction.frame.depth)[measured].max() < 1e-4
    assert (frame.labels == reconstruction.observation.labels).all()
    assert frame.camera.T_world_camera == pytest.approx(reconstruction.frame.camera.T_world_camera)
    (tmp_path / "result" / "frame" / "depth.png").write_bytes(b"")
    with pytest.raises(DataError, match="map the frame again"):
        stored.frame()


def test_parts_are_convex_closed_and_close_to_the_mesh():
    for mesh in (mug(), bracket()):
        (found,) = convex_parts([mesh])
        assert len(found.parts) >= 3
        for part in found.parts:
            assert part.mesh.is_watertight
            assert part.mesh.is_winding_consistent
            assert part.mesh.is_convex
            assert part.volume == pytest.approx(part.mesh.volume)
            assert part.face_normals == pytest.approx(part.mesh.face_normals, abs=1e-4)
            assert len(part.edges_unique) == len(part.mesh.edges_unique)
        assert found.error_m < 3e-3
        assert (found.missing_m, found.excess_m) == parts_error(mesh, found.parts)


def test_parts_and_mesh_agree_in_coal():
    """A probe ball that touches the mesh's surface touches the parts as well, within 3 mm, and the
    reverse."""
    coal = pytest.importorskip("coal")
    mesh = mug()
    (found,) = convex_parts([mesh])
    hulls = [_coal_convex(coal, part) for part in found.parts]
    surface = _coal_mesh(coal, mesh)
    rng = np.random.default_rng(0)
    drawn, face = trimesh.sample.sample_surface(mesh, 150, seed=0)
    radius = 0.004
    for offset in (-0.003, 0.003):  # ball's nearest point 3 mm inside of the surface, or 3 mm short of it
        centres = drawn + mesh.face_normals[face] * (radius + offset)
        for centre in centres[rng.permutation(len(centres))[:100]]:
            ball, place = coal.Sphere(radius), coal.Transform3s(np.eye(3), centre)
            if offset > 0 and _hits(coal, surface, coal.Sphere(radius + 0.99 * offset), place):
                continue  # in the narrow hollow the ball is nearer than that to another place
            hit = any(_hits(coal, hull, ball, place) for hull in hulls)
            assert hit == (offset < 0)


def test_a_mug_stays_open_and_a_box_stays_one_part():
    (cut, box) = convex_parts([mug(), trimesh.creation.box((0.1, 0.2, 0.05))])
    hollow = np.array([[0, 0, z] for z in np.linspace(0.02, MUG_HEIGHT + 0.05, 20)])
    for part in cut.parts:
        assert not part.mesh.contains(hollow).any()
    assert len(box.parts) == 1
    assert box.error_m < 1e-4


def test_parts_come_from_the_cache_the_second_time(tmp_path, monkeypatch):
    monkeypatch.setenv("CONTRAMAP_CACHE", str(tmp_path))
    first = convex_parts([bracket()])
    (kept,) = tmp_path.rglob("*.npz")

    def refuse(*_):
        raise AssertionError("cut again")

    monkeypatch.setattr(CutProcess, "begin", refuse)
    again = convex_parts([bracket()])
    assert [len(p.vertices) for p in again[0].parts] == [len(p.vertices) for p in first[0].parts]
    good = kept.read_bytes()
    np.savez(tmp_path / "nan.npz", np.full((8, 3), np.nan))
    np.savez(tmp_path / "none.npz")
    broken = [(tmp_path / name).read_bytes() for name in ("nan.npz", "none.npz")]
    for content in (b"damaged", good[:-200], b"", *broken):
        kept.write_bytes(content)
        with pytest.raises(AssertionError, match="cut again"):
            convex_parts([bracket()])


def test_splinters_that_engines_refuse_are_left_out():
    flat = np.array([[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0], [0.01, 0.01, 1e-9]])
    assert convex_hull(flat) is None
    assert convex_hull(flat + np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 1e-3]])) is not None


def _hits(coal, shape, ball, place) -> bool:
    request, result = coal.CollisionRequest(), coal.CollisionResult()
    return coal.collide(shape, coal.Transform3s.Identity(), ball, place, request, result) > 0


def _coal_mesh(coal, mesh: trimesh.Trimesh):
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(mesh.faces), len(mesh.vertices))
    model.addVertices(np.asarray(mesh.vertices, float))
    model.addTriangles(np.asarray(mesh.faces, np.int64))
    model.endModel()
    return model


def _coal_convex(coal, part: trimesh.Trimesh):
    model = _coal_mesh(coal, part)
    model.buildConvexHull(True, "Qt")
    return model.convex
