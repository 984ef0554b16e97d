"""Which numbers are the same, beside numpy's sorted answer."""

from __future__ import annotations

import numpy as np
import pytest

from mapping.distinct import distinct


@pytest.mark.parametrize(("count", "most"), [(0, 5), (1, 1), (50, 3), (20_000, 5000), (20_000, 2**62)])
def test_first_places_and_groups(count, most):
    keys = np.random.default_rng(0).integers(-most, most, count)
    first, group = distinct(keys)
    _, want = np.unique(keys, return_index=True)
    np.testing.assert_array_equal(first, np.sort(want))  # in the order in which they come
    np.testing.assert_array_equal(keys[first][group], keys)


def test_numbers_a_power_of_two_apart_take_no_longer():
    keys = np.arange(4000) << 40  # whose lower bits are all the same
    first, group = distinct(np.repeat(keys, 2))
    np.testing.assert_array_equal(first, 2 * np.arange(4000))
    np.testing.assert_array_equal(group, np.repeat(np.arange(4000), 2))
