"""Holes in an image are filled by a thin plate: the one that SciPy finds, a plane where the data is one."""

import numpy as np
from scipy.interpolate import RBFInterpolator

from perception.thin_plate import block_means, thin_plate


def test_the_plate_is_scipys() -> None:
    rng = np.random.default_rng(0)
    places, wanted = rng.uniform(0, 300, (90, 2)), rng.uniform(-20, 320, (400, 2))
    wanted[:5] = places[:5]
    values = 1.5 + 0.2 * np.sin(places[:, 0] / 60) + 0.1 * np.cos(places[:, 1] / 40)
    expected = RBFInterpolator(places, values, kernel="thin_plate_spline", degree=1)(wanted)
    np.testing.assert_allclose(thin_plate(places, values, wanted), expected, atol=2e-5)
    np.testing.assert_allclose(thin_plate(places, values, wanted)[:5], values[:5], atol=2e-5)


def test_a_plane_goes_on_as_a_plane() -> None:
    rng = np.random.default_rng(0)
    places, wanted = rng.uniform(100, 200, (30, 2)), rng.uniform(0, 300, (50, 2))
    values, expected = (0.7 + at @ [0.002, -0.001] for at in (places, wanted))
    np.testing.assert_allclose(thin_plate(places, values, wanted), expected, atol=1e-5)


def test_means_over_blocks_are_those_of_their_pixels() -> None:
    rng = np.random.default_rng(0)
    pixels = np.sort(rng.choice(40 * 50, 300, replace=False))
    rows, columns = np.divmod(pixels, 50)
    values = rng.random(300)
    places, means = block_means(rows, columns, values, 7)
    block = np.stack([rows // 7, columns // 7], axis=1)
    kinds, of = np.unique(block, axis=0, return_inverse=True)
    mine = [of.reshape(-1) == kind for kind in range(len(kinds))]
    np.testing.assert_allclose(places, [[rows[some].mean(), columns[some].mean()] for some in mine])
    np.testing.assert_allclose(means, [values[some].mean() for some in mine])
