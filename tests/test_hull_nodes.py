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


def test_no_plane_is_missed_wherever_on_the_lattice_the_solid_is() -> None:
    nodes = np.stack(np.meshgrid(np.arange(16), np.arange(12), np.arange(30), indexing="ij"), -1)
    along = nodes @ DIRECTIONS.T
    for corner in ((1, 1, 1), (11, 1, 1), (1, 8, 1), (11, 8, 1), (1, 1, 25), (11, 8, 25)):
        solid = np.zeros((16, 12, 30), bool)
        i, j, k = corner
        solid[i : i + 4, j : j + 3, k : k + 4] = True
        solid[i + 3, j + 2, k] = False
        reach = along[solid]
        wanted = ((along >= reach.min(0)) & (along <= reach.max(0))).all(-1)
        assert (in_hull(solid) == wanted).all()
