"""Small frames rebuilt from public reports: several supports, masks without depth, labels far away."""

import json
from pathlib import Path

import pytest

from perception import load_frame, observe
from reconstruction import reconstruct
from reconstruction.metrics import mesh_iou

CASES = Path(__file__).parents[2] / "shared" / "cases"
pytestmark = pytest.mark.skipif(not CASES.is_dir(), reason="../shared/cases is absent")


@pytest.mark.parametrize(
    ("name", "upper", "rise"), [("frame_boards", (1, 2), 0.15), ("frame_step", (3, 4), 0.06)]
)
def test_each_object_stands_on_its_own_support(name: str, upper: tuple[int, ...], rise: float) -> None:
    observation = observe(load_frame(CASES / "08-two-heights" / name))
    for item in observation.objects:
        assert item.floor == pytest.approx(rise if item.label in upper else 0.0, abs=0.004)
        assert item.rests


@pytest.mark.parametrize("name", ["frame_patch", "frame_speckle"])
def test_labelled_pixels_without_depth_are_silhouettes(name: str) -> None:
    observation = observe(load_frame(CASES / "10-holes-in-the-mask" / name))
    assert len(observation.objects) == 4
    for item in observation.objects:
        assert len(item.guessed) > 0.25 * item.labelled


def test_labels_far_away_are_skipped() -> None:
    observation = observe(load_frame(CASES / "12-labelled-things-far-behind" / "frame"))
    assert [item.label for item in observation.objects] == [1, 2]
    assert [item.label for item in observation.skipped] == [4, 3]


def shapes_of(name: str, frame: str) -> dict[int, dict]:
    truth = json.loads((CASES / name / "case.json").read_text())["truth"]
    return {item["label"]: item for item in (truth[frame] if isinstance(truth, dict) else truth)}


@pytest.mark.parametrize("frame", ["frame_boards", "frame_step"])
def test_no_mesh_leaves_its_support(frame: str) -> None:
    result = reconstruct(load_frame(CASES / "08-two-heights" / frame))
    for item in result.objects:
        true = shapes_of("08-two-heights", frame)[item.label]
        low, high = true["bounds_m"]
        assert item.mesh.bounds[0][2] == pytest.approx(low[2], abs=0.004)
        assert item.mesh.bounds[1][2] == pytest.approx(high[2], abs=0.008)
        assert 1e3 * item.mesh.volume == pytest.approx(true["volume_litres"], rel=0.12)


@pytest.mark.parametrize("frame", ["frame_patch", "frame_speckle"])
def test_holes_in_a_mask_make_no_shaft(frame: str) -> None:
    case = CASES / "10-holes-in-the-mask"
    whole = {item.label: item for item in reconstruct(load_frame(case / "frame_whole")).objects}
    result = reconstruct(load_frame(case / frame))
    for item in result.objects:
        assert mesh_iou(item.mesh, whole[item.label].mesh) > 0.88
        true = shapes_of("10-holes-in-the-mask", frame)[item.label]
        assert 1e3 * item.mesh.volume == pytest.approx(true["volume_litres"], rel=0.12)
        assert item.watertight


def test_labels_far_away_cost_nothing() -> None:
    result = reconstruct(load_frame(CASES / "12-labelled-things-far-behind" / "frame"))
    assert [item.label for item in result.objects] == [1, 2]
    assert sum(field.occupancy.nbytes for field in result.fields) < 1e7
