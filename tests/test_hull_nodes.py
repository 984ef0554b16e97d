"""The hull of a solid on a lattice: all of the convex hull, and not much more."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import Delaunay

from reconstruction.surface.hull_nodes import DIRECTIONS, in_hull


def test_planes_have_thirteen_directions_of_which_none_is_another_s_opposite() -> None:
    both = {tuple(d) for d in DIRECTIONS} | {tuple(-d) for d in DIRECTIONS}
    assert len(DIRECTIONS) == 13
    assert len(both) == 26


@pytest.mark.parametrize("seed", range(4))
def test_the_hull_holds_the_convex_hull_and_not_much_more(seed: int) -> None:
    rng = np.random.default_rng(seed)
    nodes = np.stack(np.meshgrid(*[np.arange(24)] * 3, indexing="ij"), -1)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    from_middle = nodes - 11.5
    along = from_middle @ axis
    across = np.linalg.norm(from_middle - along[..., None] * axis, axis=-1)
    cup = (np.abs(along) < 7) & (across < 6) & ~((across < 4) & (along > -5))  # a wall and a bottom
    convex = Delaunay(np.argwhere(cup)).find_simplex(nodes.reshape(-1, 3)).reshape(cup.shape) >= 0
    found = in_hull(cup)
    assert found[convex].all()
    assert found.sum() < 1.5 * convex.sum()


def test_the_hull_of_nothing_is_empty() -> None:
    assert not in_hull(np.zeros((4, 5, 6), bool)).any()
