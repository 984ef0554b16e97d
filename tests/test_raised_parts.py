"""Parts of objects that lie flat on their support are kept; what a mask takes of the support is not."""

from __future__ import annotations

import numpy as np
import pytest

from perception.raised_parts import raised_parts

NOISE, WITHIN = 0.0015, 0.01


def table_with(height: float, tilt: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Heights (80, 100) of a noisy table, and where a plate of some height lies on it; tilt: of the table
    against the plane that was found [m across the image]."""
    heights = np.random.default_rng(0).normal(0, NOISE, (80, 100)).astype(np.float32)
    heights += np.linspace(0, tilt, 100, dtype=np.float32)
    plate = np.zeros(heights.shape, bool)
    plate[30:50, 30:70] = True
    heights[plate] += np.float32(height)
    return heights, plate


@pytest.mark.parametrize("tilt", [0.0, 0.004, -0.004])
def test_a_flat_foot_is_the_objects(tilt: float) -> None:
    heights, plate = table_with(0.0025, tilt)
    found = raised_parts(heights, plate, ~plate, NOISE, WITHIN)
    assert found[plate].mean() > 0.9


@pytest.mark.parametrize("tilt", [0.0, 0.004, -0.004])
def test_the_table_under_a_bled_mask_is_not(tilt: float) -> None:
    heights, patch = table_with(0.0, tilt)
    assert not raised_parts(heights, patch, ~patch, NOISE, WITHIN).any()


def test_of_a_foot_and_the_table_beside_it_the_foot_is_kept() -> None:
    heights, plate = table_with(0.0025)
    mask = plate.copy()
    mask[28:52, 24:76] = True
    found = raised_parts(heights, mask, ~mask, NOISE, WITHIN)
    assert found[plate].mean() > 0.85
    assert found[mask & ~plate].mean() < 0.2


def test_a_rim_says_nothing() -> None:
    heights, _ = table_with(0.0)
    mask = np.zeros(heights.shape, bool)
    mask[30:34, 10:90] = True
    heights[mask] = 0.002  # a ramp between an object and its table, as sensors see it
    assert not raised_parts(heights, mask, ~mask, NOISE, WITHIN).any()


def test_without_a_support_around_nothing_is_said() -> None:
    heights, plate = table_with(0.0025)
    assert not raised_parts(heights, plate, np.zeros_like(plate), NOISE, WITHIN).any()
