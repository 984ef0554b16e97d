"""Several views of one scene: evidence adds up, order does not matter, contradictions are said."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from conftest import OBJECTS, Shape, make_tabletop, shape_mesh
from scipy.spatial import cKDTree

from mapping.errors import FrameError
from perception.camera import Camera, invert_rigid, transform
from perception.frame import Frame
from perception.frame_io import save_frame
from perception.space import Region
from perception.views.choosing import without_the_least_new
from perception.views.joint_space import RANK, REGION_OF_RANK, SHARED_FROM, JointSpace
from perception.views.observing_together import observe_together
from reconstruction import load_result, reconstruct
from reconstruction.config import FusionConfig, MeshConfig, PipelineConfig
from reconstruction.files import result_folder
from reconstruction.files.scene_json import describe
from reconstruction.fitted_scene import FittedScene
from reconstruction.result import Reconstruction
from reconstruction.samples.silent import silent_in
from reconstruction.solid import Solid
from reconstruction.surface.joint_surface import JointSurface
from reconstruction.surface.measured_vertices import share_left
from reconstruction.warm_start import LEFT
from tools.cli import main

EYES = ((-0.55, 0.0, 0.5), (0.6, 0.1, 0.5), (0.0, 0.65, 0.45), (0.05, -0.65, 0.5), (-0.4, -0.45, 0.5))


@cache
def views(count: int, noise: float = 0.001) -> list[Frame]:
    """Small frames of one table from all around."""
    return [
        make_tabletop(eye=eye, size=(160, 120), noise=noise, seed=seed).frame
        for seed, eye in enumerate(EYES[:count])
    ]


@cache
def mapped(*which: int) -> Reconstruction:
    """The map of some of the views, in that order."""
    return reconstruct([views(5)[number] for number in which])


def posed(frame: Frame, T: np.ndarray) -> Frame:
    """The same image, said to be taken from elsewhere."""
    camera = frame.camera
    return replace(frame, camera=Camera(camera.K, camera.width, camera.height, T))


def shifted(frame: Frame, *shift: float) -> Frame:
    T = frame.camera.T_world_camera.copy()
    T[:3, 3] += shift
    return posed(frame, T)


def numbered(frame: Frame, order: list[int], names: dict[int, str] | None = None) -> Frame:
    """The same frame with label k + 1 as order[k]."""
    assert frame.labels is not None
    return replace(frame, labels=np.array([0, *order])[frame.labels], names=names or {})


def truth(label: int) -> Solid:
    import trimesh

    mesh = shape_mesh(OBJECTS[label - 1])
    return Solid(trimesh.Trimesh(np.asarray(mesh.vertices), np.asarray(mesh.triangles)))


def hidden_error(result: Reconstruction, label: int) -> float:
    """Mean distance [m] of the true surface from the mesh of an object."""
    points = truth(label).mesh.sample(1500, seed=0)
    return float(np.mean(Solid(result[label].mesh).distance(points)))


def test_one_frame_in_a_list_is_that_frame() -> None:
    alone, listed = reconstruct(views(5)[0]), mapped(0)
    assert alone.map.W.numpy().tobytes() == listed.map.W.numpy().tobytes()
    for a, b in zip(alone, listed, strict=True):
        assert a.mesh.export(file_type="ply") == b.mesh.export(file_type="ply")
    scenes = [describe(replace(result, timings_ms={})) for result in (alone, listed)]
    assert scenes[0] == scenes[1]
    assert "views" not in scenes[0]


def test_views_of_nothing_are_refused() -> None:
    with pytest.raises(FrameError, match="empty"):
        reconstruct([])


def test_further_views_help() -> None:
    """With views from all around, what was hidden is known: nearer to the truth, and less uncertain. Below a
    quarter of a cell nothing can be nearer: round things and cartons are that exact from one view."""
    one, four = mapped(0), mapped(0, 1, 2, 3)
    cell = MeshConfig().spacing / FusionConfig().refine
    for label in (1, 2, 3, 4):
        assert hidden_error(four, label) < max(hidden_error(one, label), cell / 4)
        assert four[label].mean_uncertainty < one[label].mean_uncertainty
    assert sum(hidden_error(four, k) for k in (1, 2, 3, 4)) < 0.8 * sum(
        hidden_error(one, k) for k in (1, 2, 3, 4)
    )
    assert all(item.watertight for item in four)
    assert min(found.agreement for found in four.agreement.values()) > 0.9


def test_the_order_of_views_does_not_matter() -> None:
    a, b = mapped(0, 1), mapped(1, 0)
    for item in a:
        np.testing.assert_allclose(b[item.label].mesh.bounds, item.mesh.bounds, atol=1e-5)
        assert b[item.label].mesh.volume == pytest.approx(item.mesh.volume, rel=1e-3)


def test_one_view_twice_changes_nothing() -> None:
    once, twice = mapped(0), mapped(0, 0)
    for item in once:
        np.testing.assert_array_equal(twice[item.label].mesh.vertices, item.mesh.vertices)
    joint = observe_together([*views(2), views(2)[1]])
    assert len(joint.views) == 2
    assert any("it is view 2 once more" in note for note in joint.notes)
    again = mapped(0, 1).update(views(2)[1])
    assert again.map is mapped(0, 1).map
    assert any("once more" in note for note in again.notes)


def test_a_camera_that_stands_still_has_another_view_with_other_noise() -> None:
    frame = views(1)[0]
    again = make_tabletop(eye=EYES[0], size=(160, 120), noise=0.001, seed=7).frame
    assert len(observe_together([frame, again]).views) == 2
    twice = reconstruct([frame, again])
    for item in mapped(0):
        apart = Solid(twice[item.label].mesh).distance(item.mesh.sample(800, seed=0))
        assert np.mean(apart) < 0.001


@pytest.mark.parametrize("count", [3000, SHARED_FROM])
def test_free_for_one_ray_is_free(count: int) -> None:
    joint = observe_together(views(2))
    space = JointSpace.joined(joint)
    rng = np.random.default_rng(0)
    points = rng.uniform((-0.2, -0.2, -0.02), (0.2, 0.2, 0.25), (count, 3)).astype(np.float32)
    each = np.stack([one.classify(points) for one in space.views])
    found = space.classify(points)
    free = (each == Region.FREE).any(0)
    assert (found[free] == Region.FREE).all()
    np.testing.assert_array_equal(found, REGION_OF_RANK[RANK[each].max(0)])
    # A view that knows of no support calls free what lies below that of another.
    blind = replace(space, floor=0.05, views=(replace(space.views[0], has_support=False), space.views[1]))
    each = np.stack([replace(one, floor=0.05).classify(points) for one in blind.views])
    assert ((each[0] == Region.FREE) & (each[1] == Region.BELOW_SUPPORT)).any()
    np.testing.assert_array_equal(blind.classify(points), REGION_OF_RANK[RANK[each].max(0)])
    occluded = found == Region.OCCLUDED
    assert occluded.any()
    assert not np.isin(each[:, occluded], (Region.FREE, Region.SURFACE)).any()
    sight = space.look(points)
    rows = np.stack([one.look(points).behind for one in space.views])
    with np.errstate(invalid="ignore"):
        np.testing.assert_array_equal(sight.behind, np.fmin.reduce(rows))
    # The pixel is that of a view that says so.
    pixels = np.stack(
        [space.stack.place(view, one.look(points).pixel) for view, one in enumerate(space.views)]
    )
    says = (pixels == sight.pixel) & ((rows == sight.behind) | np.isnan(sight.behind))
    assert says.any(0).all()


def test_a_point_of_an_object_has_its_pixel_in_the_stacked_image() -> None:
    joint = observe_together([views(2)[0], make_tabletop(eye=EYES[1], size=(128, 96)).frame], ordered=True)
    assert joint.depth.shape == (120 + 96, 160)
    for item in joint.objects:
        assert (joint.labels.reshape(-1)[item.pixels] == item.label).all()
        assert len(item.points) == len(item.pixels)


def test_the_places_of_objects_tell_which_is_which() -> None:
    """Numbers without names say nothing: view 2 has its own."""
    order = [3, 1, 4, 2]
    frames = [numbered(views(2)[0], [1, 2, 3, 4]), numbered(views(2)[1], order)]
    joint = observe_together(frames)
    assert sorted(item.label for item in joint.objects) == [1, 2, 3, 4]
    named = observe_together(views(2))
    for item in joint.objects:
        same = next(other for other in named.objects if other.label == item.label)
        assert len(same.points) == len(item.points)
    assert any("by where it is" in note for note in joint.notes)


def test_tracked_numbers_are_taken_at_their_word() -> None:
    frames = [numbered(frame, [1, 2, 3, 4]) for frame in views(2)]
    joint = observe_together(frames, track=True)
    assert sorted(item.label for item in joint.objects) == [1, 2, 3, 4]
    assert not any("by where it is" in note for note in joint.notes)


@pytest.mark.parametrize("which", [0, 2])
def test_a_wrong_pose_is_said_and_left_out(which: int) -> None:
    frames = list(views(5))
    frames[which] = shifted(frames[which], 0.0, 0.02, 0.01)
    joint = observe_together(frames)
    assert sorted(view.number for view in joint.views) == [n + 1 for n in range(5) if n != which]
    (note,) = [note for note in joint.notes if "contradicts" in note]
    assert note.startswith(f"view {which + 1} ")
    for item in joint.objects:  # not the wrong view's table
        assert abs(item.floor) < 0.002
        assert item.bounds[0][2] < 0.02
    assert not [note for note in observe_together(views(5)).notes if "contradicts" in note]


def test_a_moved_object_is_said_and_its_old_place_forgotten() -> None:
    shapes = list(OBJECTS)
    frames = list(views(4))
    shapes[1] = Shape("sphere", (0.04,), (-0.14, -0.16, 0.04))
    frames[3] = make_tabletop(tuple(shapes), eye=EYES[3], size=(160, 120), noise=0.001, seed=3).frame
    joint = observe_together(frames)
    (note,) = [note for note in joint.notes if "contradicts" in note]
    assert note.startswith("view 4 ")
    assert "2 sphere_2" in note
    assert len(joint.views) == 4
    moved = next(item for item in joint.objects if item.label == 2)
    T_table_world = joint.T_table_camera @ np.linalg.inv(joint.views[0].frame.camera.T_world_camera)
    centre = T_table_world @ [-0.02, -0.10, 0.04, 1]
    assert np.linalg.norm(np.mean(moved.bounds, axis=0) - centre[:3]) < 0.02


def test_a_view_without_objects_is_said_and_left_out() -> None:
    nothing = views(2)[1]
    assert nothing.labels is not None
    corner = (np.indices((120, 160)).sum(0) == 0).astype(np.uint16)
    few = replace(nothing, labels=corner)
    joint = observe_together([views(2)[0], few])
    assert [view.number for view in joint.views] == [1]
    assert any(note.startswith("view 2: left out") for note in joint.notes)


def test_views_from_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """One map of all frames, whose kept result answers as the one in memory does."""
    monkeypatch.setattr(result_folder, "draw_overview", lambda r, path, truth: path.write_bytes(b"none"))
    folders = []
    for number, frame in enumerate(views(5)[:2]):
        save_frame(frame, tmp_path / f"view{number}")
        folders.append(str(tmp_path / f"view{number}"))
    out = tmp_path / "result"
    assert main(["map", *folders, "--together", "--out", str(out)]) == 0
    stored, result = load_result(out), mapped(0, 1)
    assert sorted(view["number"] for view in stored.scene["views"]) == [1, 2]
    rng = np.random.default_rng(0)
    points = rng.uniform((-0.2, -0.2, 0.0), (0.2, 0.2, 0.25), (500, 3))
    assert (stored.query(points).label == result.query(points).label).mean() > 0.97
    capsys.readouterr()
    assert main(["map", folders[0], "--together", "--out", str(tmp_path / "no")]) == 2
    assert "several frames" in capsys.readouterr().err


def test_a_sheet_seen_from_both_sides_has_no_holes() -> None:
    """1.2 mm of it lie between the nodes of a lattice of 2.5 mm."""
    sheet = Shape("box", (0.0012, 0.14, 0.10), (0.03, 0.0, 0.05), 0.35)
    block = Shape("box", (0.05, 0.05, 0.05), (-0.02, -0.15, 0.025))
    frames = [
        make_tabletop((sheet, block), eye=eye, size=(200, 150), noise=0.001, seed=seed).frame
        for seed, eye in enumerate(((-0.55, 0.0, 0.35), (0.6, 0.1, 0.35)))
    ]
    result = reconstruct(frames)
    assert result.agreement[1].agreement > 0.93  # lace: 0.85
    assert result[1].mesh.volume < 0.14 * 0.10 * 0.0035


def test_what_lies_beyond_a_sheet_that_another_view_sees_is_empty() -> None:
    """The sample that asks whether a wall is thick lies in free space there."""
    sheet = Shape("box", (0.0012, 0.14, 0.10), (0.03, 0.0, 0.05), 0.35)
    eyes = ((-0.55, 0.0, 0.35), (0.6, 0.1, 0.35))
    first, second = (make_tabletop((sheet,), eye=eye, size=(200, 150)).frame for eye in eyes)
    scene = FittedScene.of(first, PipelineConfig(), further=[second])
    X, y = scene.samples.X, scene.samples.y
    beyond = cKDTree(scene.observation.objects[0].points).query(X)[0] > 0.004
    beyond &= scene.space.classify(X) == Region.FREE
    assert beyond.sum() > 500
    assert y[beyond, 1].max() == 0
    alone = FittedScene.of(first, PipelineConfig())
    far = cKDTree(alone.observation.objects[0].points).query(alone.samples.X)[0] > 0.004
    assert alone.samples.y[far, 1].max() > 0.3  # of one view it may well be thicker


@pytest.mark.slow
def test_an_update_is_the_map_of_all_views() -> None:
    updated = mapped(0, 1, 2).update(views(5)[3])
    whole = mapped(0, 1, 2, 3)
    assert sorted(view.number for view in updated.observation.views) == [1, 2, 3, 4]
    assert updated.observation.views[-1].number == 4
    for item in whole:
        apart = Solid(updated[item.label].mesh).distance(item.mesh.sample(800, seed=0))
        assert np.mean(apart) < 0.001
        assert abs(updated[item.label].mean_uncertainty - item.mean_uncertainty) < 0.02
    first, last = (result.map.report.losses for result in (whole, updated))
    assert last[0] < first[0] / 2  # it starts from what it knew
    assert last[-1] == pytest.approx(first[-1], rel=0.05)
    assert len(last) < len(first)


def test_an_update_knows_which_object_is_which() -> None:
    frames = [numbered(views(2)[0], [1, 2, 3, 4]), numbered(views(2)[1], [3, 1, 4, 2])]
    first = reconstruct(frames[0])
    joint = first.update(frames[1]).observation
    assert sorted(item.label for item in joint.objects) == [1, 2, 3, 4]
    assert joint.views[1].frame.labels is not None
    assert (joint.views[1].frame.labels == views(2)[1].labels).mean() > 0.99


def test_an_object_that_a_view_does_not_show_keeps_its_mesh() -> None:
    first = mapped(0)
    near = (0.10, 0.12, 0.10)  # the large box, and little else
    frame = make_tabletop(eye=(-0.02, -0.04, 0.3), target=near, size=(96, 72)).frame
    labels = frame.labels
    assert labels is not None
    far = next(item for item in first if item.label not in np.unique(labels))
    updated = first.update(frame)
    np.testing.assert_array_equal(updated[far.label].mesh.vertices, far.mesh.vertices)
    np.testing.assert_array_equal(updated[far.label].mesh.faces, far.mesh.faces)
    assert len(updated[1].mesh.vertices) != len(first[1].mesh.vertices)
    assert len(updated.objects) == len(first.objects)


def test_a_view_that_moves_nothing_leaves_meshes_as_they_are() -> None:
    """Only their uncertainty is read anew; where the view shows another side, they are made again."""
    known = mapped(0, 1, 2, 3)
    again = known.update(shifted(views(5)[2], 0.0003, 0.0, 0.0))
    same = [
        item.label
        for item in known
        if np.array_equal(again[item.label].mesh.faces, item.mesh.faces)
        and np.array_equal(again[item.label].mesh.vertices, item.mesh.vertices)
    ]
    assert len(same) >= 2
    silent = silent_in([view.observation for view in again.observation.views])
    for label in same:
        assert silent[label] == (4,)  # nor is the prior asked about them again
        assert abs(again[label].mean_uncertainty - known[label].mean_uncertainty) < 0.03
    # What earlier views leave of it is not read again, and the same.
    further = again.update(shifted(views(5)[2], 0.0, 0.0003, 0.0)).observation
    left, seen = again.observation.memo[LEFT], JointSurface.of(further)
    assert set(same) <= set(left)
    assert set(left) & set(further.memo[LEFT])
    for label in set(left) & set(further.memo[LEFT]):
        index = [item.label for item in further.objects].index(label)
        vertices = transform(invert_rigid(again.T_world_table), again[label].mesh.vertices)
        np.testing.assert_allclose(
            further.memo[LEFT][label], share_left(seen.edges(index), vertices), atol=1e-4
        )
    fresh = mapped(0).update(views(5)[1])
    made = [len(fresh[item.label].mesh.vertices) != len(item.mesh.vertices) for item in mapped(0)]
    assert sum(made) >= 2


def test_many_views_are_kept_to_the_most_different() -> None:
    joint = observe_together([views(2)[0], views(2)[1], shifted(views(2)[1], 0.004, 0.0, 0.0)], ordered=True)
    assert len(joint.views) == 3
    kept = without_the_least_new(joint.views, 2, views(5)[2].camera)
    assert [view.number for view in kept] == [1, 3]
    assert without_the_least_new(joint.views, 3, views(5)[2].camera) == joint.views


@pytest.mark.slow
def test_fifty_updates_keep_to_their_memory() -> None:
    """Views that are forgotten take nothing with them into later maps."""
    result = mapped(0)
    sizes = []
    for number in range(1, 51):
        result = result.update(shifted(views(5)[number % 5], 0.0002 * (number % 7), 0.0, 0.0), keep=4)
        sizes.append(size_of(result))
        assert len(result.observation.views) <= 4
    assert max(sizes[25:]) < 1.1 * max(sizes[5:25])


def size_of(result: Reconstruction) -> int:
    """Bytes of a reconstruction, with all that it keeps."""
    import pickle

    return len(pickle.dumps(replace(result, updater=None)))
