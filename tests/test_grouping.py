"""Pixels grouped by label: every pixel once, ascending; labels in the order in which they are met."""

import numpy as np
import pytest

from perception.grouping import group_by_label
from perception.quantiles import column_quantiles, quantiles


@pytest.mark.parametrize("dtype", [np.uint16, np.int32, np.int64])
@pytest.mark.parametrize("run", [1, 20])
def test_groups_are_those_of_a_search_for_each_label(dtype: type, run: int) -> None:
    rng = np.random.default_rng(0)
    labels = np.repeat(rng.choice([0, 3, 7, 60_000], 50), run).astype(dtype)
    groups = group_by_label(labels)
    assert [label for label, _ in groups] == list(dict.fromkeys(labels.tolist()))
    for label, mine in groups:
        np.testing.assert_array_equal(mine, np.flatnonzero(labels == label))


def test_no_pixels_have_no_groups() -> None:
    assert group_by_label(np.empty(0, np.uint16)) == []


@pytest.mark.parametrize("count", [1, 2, 37])
def test_quantiles_are_numpys(count: int) -> None:
    rng = np.random.default_rng(0)
    points, shares = rng.normal(size=(count, 3)).astype(np.float32), (0.0, 0.05, 0.5, 1.0)
    expected = np.quantile(points.astype(np.float64), shares, axis=0)
    np.testing.assert_allclose(column_quantiles(points, *shares), expected, rtol=1e-12)
    np.testing.assert_allclose(quantiles(points[:, 1], *shares), expected[:, 1], rtol=1e-12)
