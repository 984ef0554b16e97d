"""Physics: objects come to rest on the table, without floating or sinking, the same for the same seed."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import trimesh

from reconstruction import metrics
from sim_scenes.objects import builtin
from sim_scenes.tabletop import PlacedObject, Tabletop, TabletopConfig

pytest.importorskip("pybullet", reason="pybullet is not installed (extra `sim`, Python 3.10 or 3.11)")

FAMILIES = ["box", "can", "bowl", "cup", "banana", "wrench", "ring"]


@pytest.fixture(scope="module")
def settled() -> Iterator[tuple[Tabletop, list[PlacedObject]]]:
    rng = np.random.default_rng(11)
    models = [builtin.make(family, rng) for family in FAMILIES]
    with Tabletop() as table:
        table.drop(models, rng)
        yield table, table.placed()


def world_vertices(item: PlacedObject) -> np.ndarray:
    T = item.T_world_object
    return item.model.mesh.vertices @ T[:3, :3].T + T[:3, 3]


def world_mesh(item: PlacedObject) -> trimesh.Trimesh:
    mesh = item.model.mesh.copy()
    mesh.apply_transform(item.T_world_object)
    return mesh


def test_poses_are_rigid(settled: tuple[Tabletop, list[PlacedObject]]) -> None:
    for item in settled[1]:
        R = item.T_world_object[:3, :3]
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(R) == pytest.approx(1)


def test_objects_stay_on_the_table_and_do_not_sink(settled: tuple[Tabletop, list[PlacedObject]]) -> None:
    placed = settled[1]
    assert len(placed) >= 5
    for item in placed:
        vertices = world_vertices(item)
        assert vertices[:, 2].min() > -0.0015, item.model.name
        assert np.hypot(*vertices[:, :2].mean(axis=0)) < TabletopConfig().rest_radius_m + 0.15


def test_nothing_floats(settled: tuple[Tabletop, list[PlacedObject]]) -> None:
    placed = settled[1]
    for index, item in enumerate(placed):
        vertices = world_vertices(item)
        gap = vertices[:, 2].min()
        for other_index, other in enumerate(placed):
            if other_index != index:
                mesh = world_mesh(other)
                gap = min(gap, metrics.distance_to_surface(mesh, vertices).min())
                gap = min(gap, metrics.distance_to_surface(world_mesh(item), mesh.vertices).min())
        assert gap < 0.003, item.model.name


def test_objects_do_not_run_into_each_other(settled: tuple[Tabletop, list[PlacedObject]]) -> None:
    placed = settled[1]
    for item in placed:
        for other in placed:
            if other is item:
                continue
            mesh = world_mesh(other)
            within = world_vertices(item)[metrics.inside(mesh, world_vertices(item))]
            if len(within):
                assert metrics.distance_to_surface(mesh, within).max() < 0.004


def test_they_are_at_rest(settled: tuple[Tabletop, list[PlacedObject]]) -> None:
    table, before = settled
    table.settle()  # more time changes nothing
    for old, new in zip(before, table.placed()):
        assert np.abs(old.T_world_object - new.T_world_object).max() < 0.01


def test_same_seed_same_poses() -> None:
    poses = []
    for _ in range(2):
        rng = np.random.default_rng(4)
        models = [*builtin.draw(1, rng), builtin.make("can", rng)]
        with Tabletop() as table:
            table.drop(models, rng)
            poses.append([item.T_world_object for item in table.placed()])
    np.testing.assert_array_equal(poses[0], poses[1])


def test_what_stood_on_a_removed_object_comes_down() -> None:
    rng = np.random.default_rng(0)
    low, high = builtin.make("box", rng), builtin.make("can", rng)
    config = TabletopConfig(drop_radius_m=0.0, upright=1.0)
    with Tabletop(config) as table:
        table.drop([low, high], rng)
        both = table.placed()
        table.remove([0])
        left = table.placed()
    assert [item.model.name for item in left] == ["can"]
    assert world_vertices(left[0])[:, 2].min() < 0.002
    assert world_vertices(both[1])[:, 2].max() >= world_vertices(left[0])[:, 2].max() - 1e-3


def test_objects_that_fall_off_are_taken_away() -> None:
    rng = np.random.default_rng(0)
    config = TabletopConfig(table_size_m=(0.05, 0.05), drop_radius_m=0.3)
    with Tabletop(config) as table:
        table.drop([builtin.make("ball", rng) for _ in range(3)], rng)
        assert all(item.T_world_object[2, 3] > 0 for item in table.placed())
        assert len(table.placed()) < 3


def test_scratch_files_are_cleaned_up() -> None:
    with Tabletop() as table:
        table.drop([builtin.make("can", np.random.default_rng(0))], np.random.default_rng(0))
        folder = table._folder
        assert folder.is_dir()
    assert not folder.exists()
