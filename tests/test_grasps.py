"""Grasping: the hand's geometry and physics, contacts, clearance, figures, and a round from start to end."""

import json

import numpy as np
import pytest
import trimesh

from mapping.errors import ConfigError, DataError
from perception.camera import Camera, look_at
from sim_scenes.objects.object_model import ObjectModel
from sim_scenes.tabletop import PlacedObject, Tabletop
from tools.cli import main
from tools.grasping import vgn
from tools.grasping.antipodal import plan
from tools.grasping.attempt import STRICT, Protocol, attempt
from tools.grasping.clearance import clear, lowest
from tools.grasping.contacts import Contacts, through
from tools.grasping.figures import coverage, difference, wilson
from tools.grasping.hand import Grasp, HandConfig, hand_boxes, hand_pose
from tools.grasping.play import condition, play
from tools.grasping.rounds import Round, RoundConfig, graspable, side_by_side
from tools.grasping.shapes import Shapes
from tools.grasping.vgn_network import LAYERS, chosen_voxels, load_network

HAND = HandConfig()
DOWN, ACROSS = np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0])


def block(name: str, size: tuple[float, float, float]) -> ObjectModel:
    mesh = trimesh.creation.box(size)
    mesh.apply_translation([0, 0, size[2] / 2])
    return ObjectModel(name, "test", mesh, np.full((8, 3), 128, np.uint8), parts=(np.asarray(mesh.vertices),))


def standing(model: ObjectModel, x: float = 0.0, y: float = 0.0) -> PlacedObject:
    T = np.eye(4)
    T[:2, 3] = x, y
    return PlacedObject(model, T)


def top_grasp(y: float = 0.0, height: float = 0.04) -> Grasp:
    return Grasp(hand_pose(np.array([0, y, height]), ACROSS, DOWN), 0.04, 1.0, 1)


def test_a_hand_pose_is_a_rotation_with_its_axes_where_they_are_named():
    T = hand_pose(np.array([0.1, 0.2, 0.3]), ACROSS, DOWN)
    assert np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3))
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1)
    assert np.allclose(T[:3, 1], ACROSS)
    assert np.allclose(T[:3, 2], DOWN)
    left, right, palm = hand_boxes(HAND, 0.06)
    assert right[0, 1] - left[1, 1] == pytest.approx(0.06)
    assert left[1, 2] == right[1, 2] == 0
    assert palm[1, 2] == left[0, 2]


@pytest.mark.parametrize("protocol", [Protocol(), STRICT])
def test_a_block_between_the_fingers_is_lifted_and_one_off_them_is_touched(protocol):
    pytest.importorskip("pybullet")
    with Tabletop() as table:
        table.place(standing(block("block", (0.05, 0.04, 0.08))))
        table.place(standing(block("far", (0.02, 0.02, 0.02)), x=0.2))
        outcome = attempt(table, top_grasp(), HAND, protocol)
        assert (outcome.held, outcome.reason) == (0, "held")
        table.remove([outcome.held])
        assert [item.model.name for item in table.placed()] == ["far"]
        assert attempt(table, top_grasp(), HAND, protocol).reason == "missed"
    with Tabletop() as table:
        table.place(standing(block("block", (0.05, 0.04, 0.08))))
        outcome = attempt(table, top_grasp(y=0.03), HAND, protocol)
        assert (outcome.success, outcome.reason, outcome.touched) == (False, "contact", "object")
        assert attempt(table, top_grasp(y=0.2, height=-0.01), HAND, protocol).touched == "table"


def test_a_hand_is_clear_exactly_where_its_boxes_and_their_way_hold_no_point():
    poses = np.array([top_grasp(y).T_world_hand for y in (0.0, 0.03, 0.2)])
    side = np.array([[0.0, 0.02, 0.05], [0.0, -0.02, 0.05]])
    assert clear(poses, side, HAND).tolist() == [True, False, True]
    assert clear(poses, np.array([[0.0, 0.0, 0.15]]), HAND).tolist() == [False, False, True]  # the palm's way
    assert clear(poses, np.zeros((0, 3)), HAND).all()
    assert lowest(poses, HAND) == pytest.approx([0.04] * 3)
    sunk = poses.copy()
    sunk[:, 2, 3] = 0.001
    assert not clear(sunk, np.zeros((0, 3)), HAND).any()


def test_contacts_of_a_block_face_each_other_across_it_and_those_of_a_tube_across_its_wall():
    rng = np.random.default_rng(0)
    found = through(trimesh.creation.box((0.05, 0.04, 0.3)), 200, 0.08, rng)
    straight = found.slips < 0.2
    assert straight.sum() > 50
    assert set(np.round(found.widths[straight], 2)) <= {0.04, 0.05}
    tube = trimesh.creation.annulus(0.026, 0.03, 0.1)
    found = through(tube, 200, 0.08, rng)
    straight = found.slips < 0.3
    assert {0.004, 0.06} <= set(np.round(found.widths[straight], 3))
    pair = Contacts(np.zeros((1, 3)), np.array([[0.0, 0.03, 0.0]]), np.zeros(1))
    assert pair.directions.tolist() == [[0, 1, 0]]


def test_a_plan_avoids_what_stands_beside_its_object():
    meshes = {1: block("one", (0.05, 0.04, 0.08)).mesh, 2: block("two", (0.3, 0.1, 0.2)).mesh}
    meshes[2].apply_translation([0, 0.075, 0])  # 5 mm beside the whole of one side
    frame: object = None
    shapes = Shapes(frame, meshes, {})  # type: ignore[arg-type]
    grasp = plan(shapes, HAND, np.random.default_rng(0))
    assert grasp is not None
    assert grasp.label == 1
    assert abs(grasp.T_world_hand[0, 1]) > 0.8  # along x: across y the wall is in the way
    assert plan(Shapes(frame, {2: meshes[2]}, {}), HAND, np.random.default_rng(0)) is None  # type: ignore[arg-type]


def test_doubt_moves_a_grasp_to_where_space_is_known():
    mesh = block("bar", (0.2, 0.04, 0.05)).mesh

    def doubt(points):
        return np.where(points[:, 0] > 0, 0.5, 0.0), np.where(points[:, 0] > 0, 1.0, 0.0)

    shapes = Shapes(None, {1: mesh}, {}, doubt)  # type: ignore[arg-type]
    from tools.grasping.antipodal import DoubtConfig

    grasp = plan(shapes, HAND, np.random.default_rng(0), DoubtConfig())
    assert grasp is not None
    assert grasp.T_world_hand[0, 3] < 0
    assert grasp.details["contact"] == grasp.details["way"] == 0


def test_a_round_on_true_shapes_clears_the_table_and_repeats_itself():
    pytest.importorskip("pybullet")
    models = [block("one", (0.05, 0.04, 0.08)), block("two", (0.06, 0.03, 0.06))]
    camera = Camera(
        np.array([[150.0, 0, 80], [0, 150, 60], [0, 0, 1]]), 160, 120,
        look_at(np.array([0.4, 0.1, 0.4]), np.zeros(3)),
    )  # fmt: skip
    start = Round("two blocks", (standing(models[0]), standing(models[1], x=0.15)), camera)
    looks = []
    result = play(start, condition("truth"), Protocol(), [0], look=lambda *seen: looks.append(seen))
    assert (result["objects"], result["cleared"], result["ended"]) == (2, 2, "empty")
    assert [attempt["success"] for attempt in result["attempts"]] == [True, True]
    assert len(looks) == 2
    again = play(start, condition("truth"), Protocol(), [0])
    assert [a["score"] for a in again["attempts"]] == [a["score"] for a in result["attempts"]]


def test_objects_that_the_hand_cannot_take_are_not_drawn_and_packed_ones_stand_apart():
    config = RoundConfig()
    assert graspable(block("fits", (0.1, 0.05, 0.1)), config)
    assert not graspable(block("lies", (0.1, 0.1, 0.05)), config)
    assert not graspable(block("wide", (0.1, 0.1, 0.1)), config)
    assert not graspable(block("long", (0.3, 0.05, 0.05)), config)
    assert not graspable(block("flat", (0.1, 0.1, 0.005)), config)
    placed = side_by_side(
        [block(str(i), (0.05, 0.05, 0.05)) for i in range(4)], np.random.default_rng(0), config
    )
    boxes = [item.model.mesh.copy().apply_transform(item.T_world_object).bounds for item in placed]
    assert len(boxes) == 4
    for i, (low, high) in enumerate(boxes):
        for other_low, other_high in boxes[:i]:
            assert ((low > other_high)[:2] | (high < other_low)[:2]).any()


@pytest.mark.parametrize(("successes", "count"), [(0, 10), (10, 10), (3, 10), (150, 300)])
def test_wilsons_interval_holds_the_share_and_shrinks_with_attempts(successes, count):
    low, high = wilson(successes, count)
    assert 0 <= low <= successes / count <= high <= 1
    wider = wilson(10 * successes, 10 * count)
    assert wider[1] - wider[0] < high - low
    assert wilson(0, 0) == (0.0, 1.0)
    assert wilson(5, 10) == pytest.approx((0.2366, 0.7634), abs=1e-4)


def result_of(name: str, successes: list[bool]) -> dict:
    tries = [{"success": s, "score": float(s)} for s in successes]
    return {"settings": {"round": name}, "attempts": tries}


def test_differences_are_taken_over_shared_rounds_and_coverage_keeps_the_best_scores():
    mine = [result_of("a", [True, True]), result_of("b", [True, False]), result_of("only mine", [False] * 9)]
    theirs = [result_of("a", [False, True]), result_of("b", [False, False])]
    gain = difference(mine, theirs)
    assert gain["rounds"] == 2
    assert gain["success"] == pytest.approx(0.75 - 0.25)
    assert gain["low"] <= gain["success"] <= gain["high"]
    tries = [{"success": i < 4, "score": -i} for i in range(10)]
    steps = {step["share"]: step["success"] for step in coverage(tries)}
    assert steps[1.0] == 0.4
    assert steps[0.4] == 1.0
    assert difference(mine, []) == {"rounds": 0}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--conditions", "nonsense"], "valid conditions: raw, tsdf"),
        (["--arrangements", "heap"], "valid: packed, pile"),
        (["--rounds", "0"], "--rounds"),
        (["--conditions", "vgn-raw"], "--vgn FILE"),
        (["--vgn", "nowhere.pth"], "not the weights of VGN"),
    ],
)
def test_senseless_arguments_are_refused_in_one_line(words, said, tmp_path, capsys):
    assert main(["benchmark", "grasps", "--out", str(tmp_path), *words]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert len(error.strip().splitlines()) == 1
    with pytest.raises(ConfigError):
        condition("nonsense")


def vgn_weights(path, seed: int = 0):
    """Weights of the network's shape, drawn at random."""
    import torch

    torch.manual_seed(seed)
    sizes = [(1, 16, 5), (16, 32, 3), (32, 64, 3), (64, 64, 3), (64, 32, 3), (32, 16, 5)]
    sizes += [(16, 1, 5), (16, 4, 5), (16, 1, 5)]
    state = {}
    for name, (inner, outer, k) in zip(LAYERS, sizes):
        state[f"{name}.weight"] = 0.05 * torch.randn(outer, inner, k, k, k)
        state[f"{name}.bias"] = torch.zeros(outer)
    torch.save(state, path)
    return path


def test_the_grasp_network_answers_for_every_voxel_and_refuses_other_files(tmp_path):
    network = load_network(vgn_weights(tmp_path / "weights.pth"))
    quality, turns, widths = network(np.random.default_rng(0).random((40, 40, 40)))
    assert quality.shape == widths.shape == (40, 40, 40)
    assert ((quality > 0) & (quality < 1)).all()
    assert np.allclose(np.linalg.norm(turns, axis=-1), 1, atol=1e-5)
    (tmp_path / "other.pth").write_bytes(b"no weights")
    with pytest.raises(DataError, match="not the weights of VGN"):
        load_network(tmp_path / "other.pth")


def test_voxels_are_chosen_near_surfaces_from_outside_at_peaks_above_the_threshold():
    tsdf = np.zeros((40, 40, 40), np.float32)
    tsdf[10:30, 10:30, 10] = 0.3  # within a body
    tsdf[10:30, 10:30, 11:13] = 0.7  # outside of it
    quality, widths = np.zeros_like(tsdf), np.full_like(tsdf, 5.0)
    quality[17:24, 17:24, 9:16] = 1.0
    quality[0:8, 0:8, 30:38] = 1.0  # far from any surface
    index, score = chosen_voxels(tsdf, quality, widths)
    assert len(index) >= 1
    assert (score >= 0.9).all()
    assert ((index[:, 2] >= 11) & (index[:, 2] <= 14)).all()
    assert len(chosen_voxels(tsdf, quality, np.full_like(tsdf, 20.0))[0]) == 0
    assert len(chosen_voxels(tsdf, 0.5 * quality, widths)[0]) == 0


def test_vgns_grasp_comes_back_in_the_world(monkeypatch):
    mesh = block("one", (0.05, 0.04, 0.08)).mesh
    mesh.apply_translation([0.3, -0.2, 0])

    def network(tsdf):
        turns = np.zeros((*tsdf.shape, 4))
        turns[..., 0] = 1  # half a turn about x: down
        assert (tsdf > 0).any()
        return np.zeros_like(tsdf), turns, np.full(tsdf.shape, 4.0)

    monkeypatch.setattr(vgn, "chosen_voxels", lambda *_: (np.array([[20, 20, 18]]), np.array([1.0])))
    grasp = vgn.plan(Shapes(None, {1: mesh}, {}), network)  # type: ignore[arg-type]
    assert grasp is not None
    assert np.allclose(grasp.T_world_hand[:3, 2], [0, 0, -1])
    voxel = 0.3 / 40
    expected = [0.3 - 0.15 + 20 * voxel, -0.2 - 0.15 + 20 * voxel, -0.05 + 18 * voxel - vgn.TIPS]
    assert np.allclose(grasp.T_world_hand[:3, 3], expected)
    assert grasp.width == pytest.approx(4 * voxel)


@pytest.mark.slow
def test_the_command_writes_figures_tables_and_pictures_and_goes_on(tmp_path, capsys):
    pytest.importorskip("pybullet")
    command = [
        "benchmark",
        "grasps",
        "--out",
        str(tmp_path),
        "--objects",
        "builtin",
        "--arrangements",
        "packed",
    ]
    command += ["--rounds", "1", "--conditions", "truth", "contramap"]
    assert main(command) == 0
    figures = json.loads((tmp_path / "grasps.json").read_text())
    for item in figures["conditions"].values():
        assert item["attempts"] > 0
        assert item["low"] <= item["success"] <= item["high"]
    assert (tmp_path / "grasps.md").is_file()
    assert len(list((tmp_path / "pictures").glob("*.png"))) == sum(
        item["attempts"] for item in figures["conditions"].values()
    )
    capsys.readouterr()
    assert main(command) == 0
    assert "1 of 1 rounds are done already" in capsys.readouterr().out
    assert json.loads((tmp_path / "grasps.json").read_text()) == figures
