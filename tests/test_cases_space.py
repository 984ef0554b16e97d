"""Small frames rebuilt from public reports: several supports, masks without depth, labels far away."""

from pathlib import Path

import pytest

from perception import load_frame, observe

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
