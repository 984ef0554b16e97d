"""Cleaning: flying pixels go and thin objects stay, bled masks are cut back, parted objects stay whole."""

import dataclasses

import numpy as np
import pytest
from conftest import Shape, Tabletop, make_tabletop

from perception import Observation, PerceptionConfig, observe
from perception.camera import Camera
from perception.depth_edges import remove_flying_pixels


def bleed(labels: np.ndarray, label: int, shift: int) -> np.ndarray:
    """Grow one label by `shift` pixels to all sides, over background and other labels."""
    grown = labels.copy()
    rows, columns = np.nonzero(labels == label)
    for down in range(-shift, shift + 1):
        for right in range(-shift, shift + 1):
            row = np.clip(rows + down, 0, labels.shape[0] - 1)
            grown[row, np.clip(columns + right, 0, labels.shape[1] - 1)] = label
    return grown


def quality(scene: Tabletop, result: Observation, label: int) -> tuple[float, float]:
    """Share of the kept pixels that are the object's, and share of its pixels that were kept."""
    kept, true = result.labels == label, scene.true_labels == label
    return float((kept & true).sum() / max(1, kept.sum())), float((kept & true).sum() / true.sum())


def test_mixed_pixels_go_and_nothing_else(tabletop: Tabletop) -> None:
    depth = tabletop.true_depth
    edge = np.zeros(depth.shape, bool)
    edge[:, 1:] = np.abs(np.diff(depth, axis=1)) > 0.05
    mixed = depth.copy()
    # A sensor's footprint spans the edge: the pixel reports the mean of the two depths.
    mixed[edge] = 0.5 * (depth[edge] + np.roll(depth, 1, axis=1)[edge])
    cleaned = remove_flying_pixels(mixed, tabletop.frame.camera, PerceptionConfig())
    removed = np.isnan(cleaned) & ~np.isnan(mixed)
    assert removed[edge].mean() > 0.9
    assert removed[~edge].mean() < 0.01


@pytest.mark.parametrize("width", [1, 2, 3])
def test_thin_objects_are_not_eaten(width: int) -> None:
    camera = make_tabletop(()).frame.camera
    depth = np.full((240, 320), 1.0, np.float32)
    depth[:, 100 : 100 + width] = 0.7
    depth[120:122, :] = 0.7
    np.testing.assert_array_equal(remove_flying_pixels(depth, camera, PerceptionConfig()), depth)


def test_an_edge_drawn_out_over_several_pixels_leaves_nothing_between() -> None:
    camera = Camera(np.array([[600.0, 0, 40], [0, 600, 30], [0, 0, 1]]), 80, 60)
    depth = np.full((60, 80), 0.75, np.float32)
    depth[:, 40:] = 0.68
    depth[:, 37:41] = np.nan
    depth[::2, 38] = 0.70  # what is left of a ramp, in a column with holes
    depth[1::6, 39] = 0.695
    cleaned = remove_flying_pixels(depth, camera, PerceptionConfig())
    assert np.isnan(cleaned[:, 37:41]).all()
    np.testing.assert_array_equal(cleaned[:, :37], depth[:, :37])
    np.testing.assert_array_equal(cleaned[:, 41:], depth[:, 41:])


def test_thin_things_between_a_near_and_a_far_surface_stay() -> None:
    camera = Camera(np.array([[600.0, 0, 40], [0, 600, 30], [0, 0, 1]]), 80, 60)
    depth = np.full((60, 80), 0.75, np.float32)
    depth[:, 40:] = 0.66
    depth[20:22, 30:39] = 0.70  # a rod, two pixels wide, that ends beside the near surface
    cleaned = remove_flying_pixels(depth, camera, PerceptionConfig())
    assert np.isfinite(cleaned[20:22, 30:36]).all()


@pytest.mark.parametrize("label", [1, 2, 3, 4])
def test_a_bled_mask_is_cleaned(tabletop: Tabletop, label: int) -> None:
    labels = bleed(tabletop.frame.labels, label, 5)
    raw = ((labels == label) & (tabletop.true_labels == label)).sum() / (labels == label).sum()
    result = observe(dataclasses.replace(tabletop.frame, labels=labels))
    pure, kept = quality(tabletop, result, label)
    assert raw < 0.85
    assert pure > 0.97
    assert kept > 0.9


def test_bleed_onto_a_wall_is_cleaned() -> None:
    wall = Shape("box", (0.02, 3.0, 2.0), (0.32, 0.0, 0.6))
    scene = make_tabletop(background=(wall,), eye=(-0.75, 0.0, 0.25), noise=0.0015)
    labels = bleed(scene.frame.labels, 1, 5)
    pure, kept = quality(scene, observe(dataclasses.replace(scene.frame, labels=labels)), 1)
    assert pure > 0.97
    assert kept > 0.9


def test_a_stray_patch_of_label_is_dropped(tabletop: Tabletop) -> None:
    labels = tabletop.frame.labels.copy()
    patch = np.argwhere(labels == 3)[-400:]
    labels[patch[:, 0], patch[:, 1]] = 1  # a piece of the cylinder carries the box's label
    result = observe(dataclasses.replace(tabletop.frame, labels=labels))
    pure, kept = quality(tabletop, result, 1)
    assert pure > 0.99
    assert kept > 0.9


def test_an_object_parted_by_an_occluder_stays_whole() -> None:
    shapes = (
        Shape("box", (0.05, 0.30, 0.10), (0.12, 0.0, 0.05)),
        Shape("box", (0.04, 0.06, 0.18), (-0.05, 0.0, 0.09)),
    )
    scene = make_tabletop(shapes, eye=(-0.7, 0.0, 0.25), noise=0.0015)
    result = observe(scene.frame)
    columns = np.nonzero((scene.true_labels == 1).any(0))[0]
    middle = scene.true_labels[:, columns.min() : columns.max()].copy()
    assert not (middle == 1)[:, middle.shape[1] // 2].any()  # it is parted indeed
    pure, kept = quality(scene, result, 1)
    assert pure > 0.97
    assert kept > 0.85


@pytest.mark.parametrize("height", [0.005, 0.01])
@pytest.mark.parametrize("kind", ["plate", "knife"])
def test_flat_objects_survive(kind: str, height: float) -> None:
    flat = (
        Shape("cylinder", (0.09, height), (0.05, 0.0, height / 2))
        if kind == "plate"
        else Shape("box", (0.02, 0.20, height), (0.05, 0.0, height / 2))
    )
    scene = make_tabletop((flat,), noise=0.0015, size=(640, 480))
    pure, kept = quality(scene, observe(scene.frame), 1)
    assert pure > 0.99
    assert kept > 0.7


def test_counts_of_dropped_pixels_add_up(tabletop: Tabletop) -> None:
    labels = bleed(tabletop.frame.labels, 1, 4)
    result = observe(dataclasses.replace(tabletop.frame, labels=labels))
    for item in result.objects:
        assert item.labelled == (labels == item.label).sum()
        assert item.dropped == item.labelled - (result.labels == item.label).sum()
