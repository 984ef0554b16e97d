"""Evidence turned about a vertical axis: the axis is found, and what it says of a cup is right."""

from __future__ import annotations

import numpy as np
import pytest

from perception.camera import transform
from perception.observing import observe
from perception.space import Space
from reconstruction.prior.evidence import RayLookup
from reconstruction.prior.features import ObjectBox
from reconstruction.prior.revolution import REVOLUTION_NAMES, Revolution, vertical_axis
from sim_scenes.training.mesh_blocks import box as block
from sim_scenes.training.mesh_blocks import turned as lathe
from sim_scenes.training.scenes import SceneConfig, TrainingScene, inside, make_training_scene
from sim_scenes.training.shapes import TrainingShape
from sim_scenes.training.vessels import wall

pytest.importorskip("open3d")
ALONE = SceneConfig(
    objects=(1, 1),
    upright=1.0,
    upside_down=0.0,
    leaning=0.0,
    elevation_deg=(30.0, 45.0),
    distance_m=(0.5, 0.8),
    spread_m=0.0,
    off_centre=0.0,
    noisy=0.0,
    noisy_labels=0.0,
    widths_px=(640,),
)
RADIUS, HEIGHT, THICK = 0.045, 0.10, 0.004


def cup(rng: np.random.Generator) -> TrainingShape:
    share = np.linspace(0, 1, 5)
    outline = wall(np.full(5, RADIUS), HEIGHT * share, THICK, 0.006)
    return TrainingShape("cup", (lathe(outline),))


def carton(rng: np.random.Generator) -> TrainingShape:
    return TrainingShape("carton", (block([0.08, 0.05, 0.15], [0, 0, 0.075]),))


def look(scene: TrainingScene):
    """Box, turned evidence, T_world_table and the observed space of the only object of a scene."""
    observation = observe(scene.frame, seed=0)
    space = Space.of(observation)
    lookup = RayLookup(observation, space)
    visible = observation.objects[0].points
    box = ObjectBox.around(visible, space.origin)
    T_world_table = scene.frame.camera.T_world_camera @ np.linalg.inv(observation.T_table_camera)
    return box, Revolution.of(box, visible, lambda points: lookup(points, 0)), T_world_table, space


@pytest.mark.parametrize("seed", range(2))
def test_the_axis_of_a_cup_is_found(seed: int) -> None:
    scene = make_training_scene(cup, np.random.default_rng(seed), ALONE)
    box, body, T_world_table, _ = look(scene)
    foot = box.back(np.array([[*body.axis, 0.0]], np.float32))
    true = scene.shapes[1].parts[0].vertices.mean(0)
    found = transform(T_world_table, foot)[0]
    assert np.hypot(*(found - true)[:2]) < 0.005
    assert body.misfit < 0.05


def test_circles_do_not_fit_a_carton() -> None:
    rounds = [look(make_training_scene(cup, np.random.default_rng(s), ALONE))[1].misfit for s in range(2)]
    boxes = [look(make_training_scene(carton, np.random.default_rng(s), ALONE))[1].misfit for s in range(2)]
    assert min(boxes) > max(rounds)


def test_turned_evidence_tells_the_far_wall_from_the_cavity() -> None:
    scene = make_training_scene(cup, np.random.default_rng(1), ALONE)
    box, body, T_world_table, space = look(scene)
    rng = np.random.default_rng(0)
    local = rng.uniform(-1, 1, (40_000, 3)).astype(np.float32)
    points = box.back((local + 1) / 2 * box.size.astype(np.float32) + box.low.astype(np.float32))
    hidden = (space.depth_behind(points) > 0.002) & (points[:, 2] > 0.02) & (points[:, 2] < 0.09)
    truth = inside(scene.shapes[1], transform(T_world_table, points[hidden]))
    rows = dict(zip(REVOLUTION_NAMES, body.channels(box, local[hidden])))
    assert truth.sum() > 50
    # Nearer to the turned profile than elsewhere, and hardly ever where rays passed at the same radius.
    assert np.median(rows["profile_distance_15mm"][truth]) > 0.6
    assert np.median(rows["profile_distance_15mm"][~truth]) < 0.2
    assert rows["turned_free_share"][truth].mean() < 0.5 * rows["turned_free_share"][~truth].mean()


def test_points_all_in_one_place_have_an_axis() -> None:
    points = np.full((40, 3), 0.1, np.float32)
    axis, misfit = vertical_axis(points, ObjectBox.around(points, np.array([-0.5, 0.0, 0.4])))
    assert np.isfinite(axis).all()
    assert np.isfinite(misfit)
