"""The command that compares views from straight above, and cut ones, with the tilted view of one scene."""

import json
from pathlib import Path

import numpy as np
import pytest
from benchmark_scenes import write_scenes

from mapping.errors import ConfigError, DataError
from perception import load_frame
from reconstruction.solid import Solid
from sim_scenes.other_views import SIDES, OtherViews, Side, shown, whole
from sim_scenes.truth import load_truth
from tools.above_and_cut import main, scores


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scenes(tmp_path_factory.mktemp("scenes")) / "scene_0000"


def test_a_camera_above_has_all_objects_in_its_image(scene: Path) -> None:
    views, like = OtherViews(load_truth(scene)), load_frame(scene).camera
    above = views.from_above(like)
    assert np.allclose(above.camera.T_world_camera[:3, 2], [0, 0, -1])
    assert whole(above, [1, 2]) == [1, 2]
    assert above.labels is not None
    height = above.camera.T_world_camera[2, 3]
    assert np.nanmin(above.depth[above.labels == 1]) == pytest.approx(height - 0.08, abs=1e-4)


@pytest.mark.parametrize("side", SIDES)
def test_a_turned_camera_cuts_an_object_by_the_share_asked_for(scene: Path, side: Side) -> None:
    views, frame = OtherViews(load_truth(scene)), load_frame(scene)
    cut = views.cut(frame, 2, 0.3, side)
    assert np.allclose(cut.camera.T_world_camera[:3, 3], frame.camera.T_world_camera[:3, 3])
    assert shown(frame, 2, cut.camera) == pytest.approx(0.7, abs=0.05)
    assert whole(cut, [2]) == []
    assert cut.labels is not None
    border = {"left": np.s_[:, 0], "right": np.s_[:, -1], "top": np.s_[0], "bottom": np.s_[-1]}[side]
    assert (cut.labels[border] == 2).any()


def test_a_label_that_does_not_show_cannot_be_cut(scene: Path) -> None:
    with pytest.raises(DataError, match="label 9 does not show"):
        OtherViews(load_truth(scene)).cut(load_frame(scene), 9, 0.3, "left")


@pytest.mark.slow
def test_a_ball_stays_where_it_is(scene: Path, tmp_path: Path) -> None:
    main(scene.parent, cuts=1, limit=1, json=tmp_path / "a.json")
    rows = json.loads((tmp_path / "a.json").read_text())["rows"]
    assert {row["view"] for row in rows} == {"above", "cut"}
    for row in rows:
        assert row["seen"]["iou"] > row["tilted"]["iou"] - 0.15
        assert abs(row["seen"]["hover"]) < 0.005


def test_rows_become_tables(tmp_path: Path) -> None:
    good = {"iou": 0.8, "hover": 0.001, "beyond_free": float("nan")}
    lost = {"iou": 0.0, "hover": float("nan"), "beyond_free": 0.0}
    row = {"scene": "ten/s", "view": "above", "label": 1, "name": "ball", "shown": 1.0, "refused": ""}
    rows = [{**row, "tilted": good, "seen": good}, {**row, "view": "cut", "tilted": good, "seen": lost}]
    for name in "ab":
        (tmp_path / name).write_text(json.dumps({"rows": rows, "written_by": [f"piece {name}"]}))
    main(add=(tmp_path / "a", tmp_path / "b"), table=tmp_path / "twice.md")
    text = (tmp_path / "twice.md").read_text()
    assert "- piece a\n- piece b" in text
    assert "| ten | above | 1 | 2 | 0.800 | 0.800 | 0.000 | 100% |" in text
    assert "| ten | cut | 1 | 2 | 0.800 | 0.000 | 0.800 | 0% |" in text
    with pytest.raises(ConfigError, match="give a folder of scenes"):
        main()


def test_an_object_without_a_mesh_scores_nothing(scene: Path) -> None:
    truth = load_truth(scene)
    assert scores(None, 1, Solid(truth.meshes[1]))["iou"] == 0
