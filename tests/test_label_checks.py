"""Labels as people have them, against the scene: tables, numbers used twice, slivers, far labels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import Shape, Tabletop, make_tabletop

from mapping import FrameError
from perception import Frame, observe
from perception.checks.depth_values import without_lone_far, without_sentinels
from perception.inputs.label_files import read_labels
from perception.inputs.label_forms import as_labels
from perception.inputs.label_slivers import without_slivers


def with_labels(frame: Frame, labels: np.ndarray) -> Frame:
    return Frame(frame.depth, frame.camera, frame.rgb, labels.astype(np.uint16), frame.names)


@pytest.mark.parametrize("number", [5, 300])
def test_a_labelled_table_is_the_support(tabletop: Tabletop, number: int) -> None:
    frame = tabletop.frame
    table = (frame.labels == 0) & np.isfinite(frame.depth)
    result = observe(with_labels(frame, np.where(table, number, frame.labels)))
    (skipped,) = result.skipped
    assert skipped.label == number
    assert "support plane" in skipped.reason
    assert [item.pixels.size for item in result.objects] == [
        item.pixels.size for item in observe(frame).objects
    ]


def test_a_tray_on_the_table_stays_an_object() -> None:
    shapes = (
        Shape("box", (0.42, 0.30, 0.03), (0.05, 0.0, 0.015)),
        Shape("sphere", (0.04,), (-0.02, -0.08, 0.07)),
        Shape("cylinder", (0.035, 0.12), (0.05, 0.08, 0.09)),
    )
    result = observe(make_tabletop(shapes, noise=0.001).frame)
    assert {item.label for item in result.objects} == {1, 2, 3}


def test_one_number_on_two_things_is_split(tabletop: Tabletop) -> None:
    frame = tabletop.frame
    result = observe(with_labels(frame, np.where(frame.labels == 3, 2, frame.labels)))
    names = {item.label: item.name for item in result.objects}
    assert names == {1: "box_1", 2: "sphere_2", 4: "box_4", 5: "sphere_2_2"}
    assert any("covers several things" in note for note in result.notes)


def test_far_and_large_things_are_set_aside() -> None:
    far = Shape("box", (0.5, 0.5, 1.5), (9.0, 0.5, 0.2))
    scene = make_tabletop((*make_tabletop().shapes, far), eye=(-0.7, 0.0, 0.35), noise=0.001)
    result = observe(scene.frame)
    assert {item.label for item in result.objects} == {1, 2, 3, 4}
    (skipped,) = result.skipped
    assert "far" in skipped.reason or "large" in skipped.reason


@pytest.mark.parametrize("how", ["bilinear", "bicubic", "jpeg"])
def test_slivers_of_interpolated_labels_are_mended(tabletop: Tabletop, tmp_path: Path, how: str) -> None:
    from PIL import Image

    true = 20 * tabletop.true_labels.astype(np.uint8)
    image = Image.fromarray(true)
    if how == "jpeg":
        image.save(tmp_path / "labels.jpg", quality=90)
        spoilt = np.array(Image.open(tmp_path / "labels.jpg"))
        path = tmp_path / "labels.jpg"
    else:
        half = image.resize((160, 120), Image.Resampling.NEAREST)
        spoilt = np.array(half.resize((320, 240), Image.Resampling[how.upper()]))
        path = tmp_path / "labels.png"
        Image.fromarray(spoilt).save(path)
    assert len(np.unique(spoilt)) > 6
    labels = read_labels(path)
    assert set(np.unique(labels.image).tolist()) == {0, 20, 40, 60, 80}
    assert (labels.image == true).mean() > 0.98
    assert "nearest" in labels.notes[0]


def test_whole_labels_have_no_slivers(tabletop: Tabletop) -> None:
    image, changed, vanished = without_slivers(tabletop.true_labels)
    assert changed == 0
    assert vanished == []
    np.testing.assert_array_equal(image, tabletop.true_labels)


def test_a_pen_is_no_sliver() -> None:
    image = np.zeros((60, 80), np.uint16)
    image[10:40, 10:40] = 7
    image[50:52, 5:70] = 3
    image[5:55, 60] = 2
    assert without_slivers(image)[1] == 0


@pytest.mark.parametrize(
    ("numbers", "kept"),
    [
        ([0, 1, 2, 255], {0, 1, 2}),  # ignore
        ([0, 85, 170, 255], {0, 85, 170, 255}),  # spread over the bytes to be seen
        ([0, 255], {0, 255}),  # one mask
        ([0, 127, 255], {0, 127, 255}),
        ([0, 3, 65535], {0, 3}),
        ([-1, 1, 4], {0, 1, 4}),
    ],
)
def test_what_is_no_object_among_the_numbers(numbers: list[int], kept: set[int]) -> None:
    image = np.repeat(np.array(numbers), 20)[None].repeat(20, 0)
    labels = as_labels(image, "labels")
    assert set(np.unique(labels.image).tolist()) == kept
    assert bool(labels.notes) == (set(numbers) != kept)


def test_a_named_top_number_is_an_object() -> None:
    image = np.repeat(np.array([0, 1, 255]), 20)[None].repeat(20, 0)
    assert 255 in as_labels(image, "labels", named=(1, 255)).image


def test_zero_is_an_object_where_255_is_the_background() -> None:
    image = np.full((40, 40), 255)
    image[5:15, 5:15] = 0
    image[25:35, 5:15] = 1
    labels = as_labels(image, "labels")
    assert set(np.unique(labels.image).tolist()) == {0, 1, 2}
    assert "0 is an object" in labels.notes[1]


@pytest.mark.parametrize("shape", [(3,), (2, 3, 4, 5), (5, 6, 7)])
def test_labels_of_no_known_shape_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(FrameError, match="labels"):
        as_labels(np.arange(np.prod(shape)).reshape(shape), "labels")


def test_sentinels_and_lone_far_pixels(tabletop: Tabletop) -> None:
    depth = np.nan_to_num(tabletop.true_depth, nan=9.999).astype(np.float32)
    cleaned, notes = without_sentinels(depth)
    np.testing.assert_array_equal(np.isnan(cleaned), np.isnan(tabletop.true_depth))
    assert "9.999 m exactly" in notes[0]
    assert without_sentinels(tabletop.true_depth)[1] == []
    speckled = tabletop.true_depth.copy()
    rows, columns = np.nonzero(tabletop.true_labels)
    rows, columns = rows[::40], columns[::40]
    speckled[rows, columns] = 3.0
    cleaned, count = without_lone_far(speckled, tabletop.true_labels)
    assert count > 0.9 * len(rows)
    assert np.isnan(cleaned[rows, columns]).mean() > 0.9
    assert without_lone_far(tabletop.true_depth, tabletop.true_labels)[1] < 20
