"""Errors of camera poses: as large as said; and what the study of next views looks at."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import OBJECTS, make_tabletop, shape_mesh

from mapping.errors import ConfigError
from perception.camera import invert_rigid, transform
from perception.frame_io import load_frame, save_frame
from perception.space import Region
from reconstruction import reconstruct
from sim_scenes.dataset import _misstate_poses
from sim_scenes.pose_noise import check_pose_noise, noisy_pose
from tools.looking_around import VOXEL, World, rear_sides, table
from tools.views import farthest_first, posed


def error_of(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Metres and degrees between two poses."""
    turn = np.degrees(np.arccos(np.clip((np.trace(a[:3, :3].T @ b[:3, :3]) - 1) / 2, -1, 1)))
    return float(np.linalg.norm(a[:3, 3] - b[:3, 3])), float(turn)


def test_poses_are_wrong_by_up_to_so_much() -> None:
    T = make_tabletop(size=(32, 24)).frame.camera.T_world_camera
    rng = np.random.default_rng(0)
    errors = np.array([error_of(T, noisy_pose(T, 0.01, 2.0, rng)) for _ in range(200)])
    assert (errors <= (0.01 + 1e-9, 2.0 + 1e-6)).all()
    assert (errors.max(0) > (0.009, 1.8)).all()
    assert (errors.min(0) < (0.001, 0.2)).all()
    np.testing.assert_allclose(noisy_pose(T, 0.0, 0.0, rng), T, atol=1e-12)
    with pytest.raises(ConfigError, match="metres in"):
        check_pose_noise((-1.0, 0.0))


def test_the_files_of_views_state_wrong_poses(tmp_path: Path) -> None:
    frame = make_tabletop(size=(64, 48)).frame
    for view in (".", "views/1"):
        save_frame(frame, tmp_path / view)
    _misstate_poses(tmp_path, ["views/1"], {"pose_noise": [0.01, 2.0]}, np.random.default_rng(3))
    true = frame.camera.T_world_camera
    metres, degrees = error_of(true, load_frame(tmp_path / "views/1").camera.T_world_camera)
    assert 0 < metres <= 0.01
    assert 0 < degrees <= 2
    assert json.loads((tmp_path / "camera.json").read_text())["T_world_camera"] == true.tolist()


def test_rear_sides_are_unseen_and_right_behind_what_was_measured() -> None:
    frame = make_tabletop(size=(120, 90)).frame
    result = reconstruct(frame)
    space = rear_sides(result)
    assert len(space.points) > 50
    region = result.space.classify(space.points)
    assert np.isin(region, (Region.OCCLUDED, Region.OUT_OF_VIEW)).all()
    measured = space.origin + VOXEL * np.argwhere(space.known > 0)
    apart = np.linalg.norm(space.points[:, None] - measured, axis=2).min(1)
    assert apart.max() < 1.01 * VOXEL
    # From behind most of them show, from where the frame was taken next to none.
    behind = make_tabletop(eye=(0.6, 0.0, 0.5), size=(120, 90)).frame.camera
    own, back = (
        space.gain(camera, invert_rigid(camera.T_world_camera) @ result.T_world_table)
        for camera in (frame.camera, behind)
    )
    assert back > own + 0.2


def test_a_world_shows_what_its_truth_is() -> None:
    import trimesh

    meshes = {}
    for label, shape in enumerate(OBJECTS, 1):
        mesh = shape_mesh(shape)
        meshes[label] = trimesh.Trimesh(np.asarray(mesh.vertices), np.asarray(mesh.triangles))
    items = [SimpleNamespace(label=label, name=f"thing_{label}") for label in meshes]
    scene = make_tabletop(size=(120, 90))
    world = World(SimpleNamespace(meshes=meshes, objects=items), scene.frame.camera)  # type: ignore[arg-type]
    frame = world.frame(scene.frame.camera.T_world_camera)
    assert frame.labels is not None
    assert (frame.labels == scene.true_labels).mean() > 0.999
    on = scene.true_labels > 0
    np.testing.assert_allclose(frame.depth[on], scene.true_depth[on], atol=1e-4)
    local = transform(np.eye(4), world.voxels)
    assert local[:, 2].min() > 0
    assert posed(frame, np.eye(4)).camera.T_world_camera.tolist() == np.eye(4).tolist()


def test_the_table_says_when_looking_has_done_what_the_circle_does() -> None:
    curve = {
        "look": [1, 0.4, 0.2],
        "rear side": [1, 0.5, 0.3],
        "circle": [1, 0.8, 0.45],
        "random": [1, 0.7, 0.5],
    }
    text = table([curve] * 7, 3)
    assert "leaves after 3 views, look leaves after 2 views" in text
    assert "less than circle in 7 of 7 scenes" in text


def test_views_are_added_farthest_first() -> None:
    """Of a circle of eight, the second is opposite to the first, the next two halve what is left."""
    frame = make_tabletop(size=(32, 24)).frame
    frames = []
    for angle in np.arange(8) * (2 * np.pi / 8):
        T = np.eye(4)
        T[:3, 3] = 0.6 * np.cos(angle), 0.6 * np.sin(angle), 0.5
        frames.append(posed(frame, T))
    places = [id(one) for one in frames]
    order = [places.index(id(one)) for one in farthest_first(frames)]
    assert order[:2] == [0, 4]
    assert sorted(order[2:4]) == [2, 6]
    assert sorted(order) == list(range(8))
