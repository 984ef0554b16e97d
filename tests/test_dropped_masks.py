"""The command that drops masks and asks what is called free."""

from conftest import Tabletop, shape_mesh
from trimesh import Trimesh

from reconstruction.solid import Solid
from tools.dropped_masks import Drop, judge


def test_little_of_a_dropped_object_is_free(tabletop: Tabletop) -> None:
    for label in (3, 4):
        legacy = shape_mesh(tabletop.shapes[label - 1])
        solid = Solid(Trimesh(legacy.vertices, legacy.triangles))
        row = judge(Drop("tabletop", tabletop.frame, label, solid))
        assert row is not None
        assert row["inside_free"] <= 0.01
        assert row["measured_free"] <= 0.001
        assert row["inside_other"] > 0.1
