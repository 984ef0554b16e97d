"""The statistics of sensor and label noise on surfaces with known depth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from perception.camera import Camera
from sim_scenes.sensor_noise import (
    LabelNoiseConfig,
    SensorNoiseConfig,
    in_stereo_shadow,
    noisy_depth,
    noisy_labels,
    viewing_cosine,
)

CAMERA = Camera(np.array([[300.0, 0, 159.5], [0, 300, 119.5], [0, 0, 1]]), 320, 240)
ONLY_AXIAL = SensorNoiseConfig(disparity_step=1e-9)
ONLY_STEPS = replace(SensorNoiseConfig(), axial=0.0)


def wall(z: float) -> np.ndarray:
    return np.full((240, 320), z, np.float32)


@pytest.mark.parametrize("z", [0.5, 1.0, 2.0])
def test_axial_noise_grows_with_depth_squared(z: float) -> None:
    error = noisy_depth(wall(z), CAMERA, np.random.default_rng(0), ONLY_AXIAL) - z
    assert np.nanstd(error) == pytest.approx(ONLY_AXIAL.axial * z**2, rel=0.05)
    assert abs(np.nanmean(error)) < 0.1 * ONLY_AXIAL.axial * z**2


@pytest.mark.parametrize("z", [0.6, 1.2])
def test_depth_is_quantised_by_disparity(z: float) -> None:
    slanted = wall(z) + np.linspace(0, 0.05, 320, dtype=np.float32)
    levels = np.unique(noisy_depth(slanted, CAMERA, np.random.default_rng(0), ONLY_STEPS))
    levels = levels[np.isfinite(levels)]
    assert np.median(np.diff(levels)) == pytest.approx(ONLY_STEPS.disparity_step * z**2, rel=0.15)


def test_a_wall_seen_straight_keeps_its_depth() -> None:
    assert np.isfinite(noisy_depth(wall(1.0), CAMERA, np.random.default_rng(0))).all()


def test_grazing_surfaces_lose_depth() -> None:
    camera = CAMERA
    floor_height = 0.2
    with np.errstate(divide="ignore"):
        depth = np.where(camera.rays[..., 1] > 0.01, floor_height / camera.rays[..., 1], np.nan)
    depth = np.where(depth < 15, depth, np.nan).astype(np.float32)
    angle = np.rad2deg(np.arccos(np.clip(viewing_cosine(depth, camera), 0, 1)))
    noisy = noisy_depth(depth, camera, np.random.default_rng(0))
    steep, grazing = (depth < 3) & (angle < 70), np.isfinite(depth) & (angle > 86)
    assert steep.any()
    assert grazing.any()
    assert np.isnan(noisy[grazing]).mean() > 0.6
    assert np.isnan(noisy[steep]).mean() < 0.02


def test_flying_pixels_lie_between_foreground_and_background() -> None:
    depth = wall(1.0)
    depth[80:160, 100:200] = 0.6
    noisy = noisy_depth(depth, CAMERA, np.random.default_rng(0))
    flying = (noisy > 0.65) & (noisy < 0.95)
    assert flying.sum() > 50
    rows, columns = np.nonzero(flying)
    off_border = np.minimum.reduce([np.abs(rows - 79.5), np.abs(rows - 159.5)])
    off_border = np.minimum(off_border, np.minimum(np.abs(columns - 99.5), np.abs(columns - 199.5)))
    assert off_border.max() < 2  # nowhere but at the edge
    assert np.isnan(noisy).sum() > 50


@pytest.mark.parametrize("baseline", [0.05, -0.05])
def test_stereo_shadow_is_as_wide_as_the_jump_in_disparity(baseline: float) -> None:
    depth = wall(1.0)
    depth[80:160, 100:200] = 0.5
    shadow = in_stereo_shadow(depth, CAMERA, baseline)
    width = 300 * 0.05 * (1 / 0.5 - 1 / 1.0)  # f b (1 / near - 1 / far) = 15 pixels
    beside = shadow[80:160, :100] if baseline > 0 else shadow[80:160, 200:]
    np.testing.assert_allclose(beside.sum(axis=1), width, atol=1)
    assert shadow.sum() == beside.sum()
    noisy = noisy_depth(depth, CAMERA, np.random.default_rng(0), SensorNoiseConfig(shadow_m=baseline))
    assert np.isnan(noisy[shadow]).all()


def test_creases_are_rounded_and_jumps_stay() -> None:
    roof = wall(1.0) - 0.002 * np.abs(np.arange(320, dtype=np.float32) - 160)
    roof[:60] = 2.0
    config = SensorNoiseConfig(
        axial=0.0, disparity_step=1e-9, grazing_deg=89.9, flying=0.0, edge_holes=0.0, rounding_px=3.0
    )
    error = noisy_depth(roof, CAMERA, np.random.default_rng(0), config) - roof
    assert error[150, 160] < -0.001  # the crease is cut off
    assert np.abs(error[150, 100]) < 5e-4
    assert np.nanmax(np.abs(error[55:65])) < 0.01


def test_waves_have_their_size() -> None:
    config = SensorNoiseConfig(axial=0.0, disparity_step=1e-9, waves=0.005)
    error = noisy_depth(wall(1.0), CAMERA, np.random.default_rng(0), config) - 1.0
    assert 0.0025 < np.nanstd(error) < 0.0075
    assert np.nanstd(np.diff(error, axis=1)) < 0.001  # neighbours share it


def test_noise_depends_on_the_seed_alone() -> None:
    first, again, other = (noisy_depth(wall(1.0), CAMERA, np.random.default_rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def masks() -> np.ndarray:
    labels = np.zeros((120, 160), np.uint16)
    labels[20:60, 20:70] = 1
    labels[70:110, 90:150] = 2
    labels[10:13, 140:143] = 3  # too small to erode
    return labels


def test_label_noise_moves_borders_a_little() -> None:
    config = LabelNoiseConfig(leak=0.0)
    changed = []
    for seed in range(10):
        noisy = noisy_labels(masks(), np.random.default_rng(seed), config)
        assert set(np.unique(noisy)) == {0, 1, 2, 3}
        both = (noisy == 1) & (masks() == 1)
        changed.append(both.sum() / ((noisy == 1) | (masks() == 1)).sum())
        assert np.all(noisy[26:54, 26:64] == 1)  # the middle stays
    assert min(changed) > 0.6
    assert len(set(changed)) > 3


def test_leaks_reach_beyond_the_border() -> None:
    config = LabelNoiseConfig(border_px=0, leak=1.0)
    noisy = noisy_labels(masks(), np.random.default_rng(0), config)
    assert (noisy[masks() == 0] > 0).sum() > 50


def test_label_noise_leaves_its_input_alone() -> None:
    labels = masks()
    noisy_labels(labels, np.random.default_rng(0))
    np.testing.assert_array_equal(labels, masks())
