"""Surfaces with fewer triangles: closed, near to what they were, as uncertain as the map is there."""

import numpy as np
import pytest
from conftest import make_tabletop
from solids import reconstructed_tabletop

from mapping.errors import DataError
from reconstruction import preset, reconstruct
from reconstruction.solid import Solid
from reconstruction.surface.simplified import simplified

TOLERANCE = 0.0003


def test_simplified_meshes_stay_where_they_were() -> None:
    whole = reconstructed_tabletop()
    frame = make_tabletop(size=(240, 180)).frame
    simple = reconstruct(frame, preset("tabletop", mesh={"simplify": TOLERANCE}))
    for before, after in zip(whole.objects, simple.objects, strict=True):
        assert after.mesh.is_watertight
        assert after.mesh.is_winding_consistent
        assert after.mesh.volume > 0
        assert len(after.mesh.faces) < 0.5 * len(before.mesh.faces)
        assert len(after.uncertainty) == len(after.mesh.vertices)
        there = Solid(before.mesh).distance(np.asarray(after.mesh.vertices, np.float32))
        back = Solid(after.mesh).distance(np.asarray(before.mesh.vertices, np.float32))
        assert there.max() < 1e-6
        assert np.quantile(back, 0.99) < 1.1 * TOLERANCE
        assert back.max() < 2.2 * TOLERANCE
        assert after.mean_uncertainty == pytest.approx(before.mean_uncertainty, abs=0.05)


def test_an_open_surface_is_refused() -> None:
    vertices = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2]])
    with pytest.raises(DataError, match="not closed"):
        simplified(vertices, faces, TOLERANCE)


def test_what_is_smaller_than_the_tolerance_is_kept_as_it_is() -> None:
    vertices = 1e-5 * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    kept, same = simplified(vertices, faces, TOLERANCE)
    np.testing.assert_array_equal(kept, vertices)
    np.testing.assert_array_equal(same, faces)
