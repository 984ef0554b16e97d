"""What hangs together: pieces and clusters are those of a search in a graph, numbered as they are met."""

import numpy as np
import pytest
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from perception.joining import connected_pieces, connected_points


def in_the_order_met(parts: np.ndarray) -> np.ndarray:
    """Part numbers (N,) counted from 0 in the order in which they are first met."""
    _, first, of = np.unique(parts, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[of.reshape(-1)]


@pytest.mark.parametrize("share", [0.05, 0.4, 0.6, 1.0])
def test_pieces_of_a_mask_are_scipys(share: float) -> None:
    mask = np.random.default_rng(1).random((40, 60)) < share
    everywhere = np.ones((40, 59), bool), np.ones((39, 60), bool)
    np.testing.assert_array_equal(connected_pieces(*everywhere, mask), ndimage.label(mask)[0])


@pytest.mark.parametrize("share", [0.3, 0.5, 0.8])
def test_pieces_follow_the_joints(share: float) -> None:
    rng = np.random.default_rng(2)
    right, down = rng.random((30, 49)) < share, rng.random((29, 50)) < share
    number = np.arange(30 * 50).reshape(30, 50)
    one = np.concatenate([number[:, :-1][right], number[:-1][down]])
    other = np.concatenate([number[:, 1:][right], number[1:][down]])
    graph = coo_matrix((np.ones(len(one), bool), (one, other)), shape=(1500, 1500))
    expected = in_the_order_met(connected_components(graph, directed=False)[1]) + 1
    found = connected_pieces(right, down, np.ones((30, 50), bool))
    np.testing.assert_array_equal(found.reshape(-1), expected)


@pytest.mark.parametrize("count", [1, 40, 3000])
def test_clusters_are_points_whose_voxels_touch(count: int) -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(-0.1, 0.2, (count, 3)).astype(np.float32)
    points[-1] = [30, -20, 9]  # a stray pixel far behind
    cells = np.floor(points * np.float32(90))
    pairs = cKDTree(cells).query_pairs(1.75, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs), bool), tuple(pairs.T)), shape=(count, count))
    expected = in_the_order_met(connected_components(graph, directed=False)[1])
    np.testing.assert_array_equal(connected_points(points, np.float32(90)), expected)
    assert len(set(expected)) > 1 or count == 1
