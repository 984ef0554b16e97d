"""Built-in objects are closed, of household size, varied, and what their names say."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from mapping.errors import ConfigError
from reconstruction import metrics
from sim_scenes.convex_parts import collision_file, write_parts
from sim_scenes.objects import builtin, shipped_shapes
from sim_scenes.objects.object_model import ObjectModel, load_model


@pytest.fixture(scope="module")
def samples() -> dict[str, list[ObjectModel]]:
    found = {}
    for index, family in enumerate(FAMILIES):
        rng = np.random.default_rng(index)
        found[family] = [builtin.make(family, rng) for _ in range(2)]
    return found


FAMILIES = builtin.families()


@pytest.mark.parametrize("family", FAMILIES)
def test_every_family_is_closed_and_of_household_size(
    samples: dict[str, list[ObjectModel]], family: str
) -> None:
    for model in samples[family]:
        assert model.watertight
        assert model.mesh.volume > 1e-6
        assert model.connected
        assert 0.03 < model.mesh.extents.max() < 0.32
        assert len(model.mesh.faces) < 30_000
        assert model.texture is not None or (
            model.vertex_colors is not None and model.vertex_colors.shape == model.mesh.vertices.shape
        )


@pytest.mark.parametrize("family", list(builtin.PROCEDURAL))
def test_two_of_a_family_differ_and_one_seed_gives_one_object(
    samples: dict[str, list[ObjectModel]], family: str
) -> None:
    first, second = samples[family]
    assert not np.allclose(first.mesh.extents, second.mesh.extents, rtol=1e-3)
    again = builtin.make(family, np.random.default_rng(FAMILIES.index(family)))
    np.testing.assert_array_equal(again.mesh.vertices, first.mesh.vertices)
    np.testing.assert_array_equal(again.vertex_colors, first.vertex_colors)


@pytest.mark.parametrize("family", ["cup", "mug", "bowl"])
def test_vessels_are_hollow(samples: dict[str, list[ObjectModel]], family: str) -> None:
    for model in samples[family]:
        low, high = model.mesh.bounds
        axis = np.array([[0.0, 0.0, low[2] + share * (high[2] - low[2])] for share in (0.3, 0.6, 0.95)])
        assert not metrics.inside(model.mesh, axis).any()
        assert metrics.inside(model.mesh, np.array([[0.001, 0.001, low[2] + 0.0012]])).all()  # the floor


def test_a_mug_has_a_handle_to_reach_through(samples: dict[str, list[ObjectModel]]) -> None:
    for model in samples["mug"]:
        assert model.mesh.euler_number == 0  # one hole: the handle


@pytest.mark.parametrize("family", list(builtin.PROCEDURAL))
def test_convex_parts_fill_the_shape(samples: dict[str, list[ObjectModel]], family: str, tmp_path) -> None:
    model = samples[family][0]
    write_parts(model, model.parts, tmp_path / "parts.obj")
    hulls = trimesh.load(tmp_path / "parts.obj", split_object=True, group_material=False)
    pieces = list(hulls.geometry.values()) if isinstance(hulls, trimesh.Scene) else [hulls]
    points = metrics.sample_surface(model.mesh, 300, np.random.default_rng(0)) - model.center_of_mass
    gaps = np.min([metrics.distance_to_surface(piece, points) for piece in pieces], axis=0)
    assert np.quantile(gaps, 0.9) < 0.005
    corners = np.concatenate([piece.vertices for piece in pieces]) + model.center_of_mass
    assert np.all(corners.min(axis=0) > model.mesh.bounds[0] - 1e-4)
    assert np.all(corners.max(axis=0) < model.mesh.bounds[1] + 1e-4)


def test_draw_prefers_different_families() -> None:
    models = builtin.draw(8, np.random.default_rng(0))
    assert len({model.name for model in models}) == 8


def test_unknown_family_names_the_valid_ones() -> None:
    with pytest.raises(ConfigError, match="bottle"):
        builtin.make("teapot", np.random.default_rng(0))


def test_saved_mesh_is_the_same_closed_mesh(samples: dict[str, list[ObjectModel]], tmp_path) -> None:
    model = samples["mug"][0]
    model.save(tmp_path / "mug.ply")
    read = load_model(tmp_path / "mug.ply", "mug", "builtin")
    assert read.watertight
    assert read.mesh.volume == pytest.approx(model.mesh.volume, rel=1e-4)
    assert read.vertex_colors is not None
    assert len(np.unique(read.vertex_colors, axis=0)) == 2  # outside and inside


@pytest.mark.skipif("duck" not in shipped_shapes.names(), reason="pybullet is not installed")
def test_hollows_survive_the_search_for_convex_parts(
    samples: dict[str, list[ObjectModel]], tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CONTRAMAP_CACHE", str(tmp_path))
    cup = samples["cup"][0]
    unknown = ObjectModel("cup", "builtin", cup.mesh, cup.vertex_colors)  # as a scan: parts unknown
    path = collision_file(unknown)
    assert path.read_text().count("o part_") > 4
    stamp = path.stat().st_mtime_ns
    assert collision_file(unknown) == path
    assert path.stat().st_mtime_ns == stamp  # from the cache
    vertices = np.array(
        [line.split()[1:4] for line in path.read_text().splitlines() if line.startswith("v ")], float
    )
    middle = vertices + cup.center_of_mass
    deep = middle[middle[:, 2] > 0.5 * cup.mesh.extents[2]]
    assert np.hypot(deep[:, 0], deep[:, 1]).min() > 0.5 * cup.mesh.extents[0] / 2  # none across the mouth
