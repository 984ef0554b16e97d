"""The command that drops masks and asks what is called free."""

import json
from pathlib import Path

import pytest
from conftest import Tabletop, shape_mesh
from trimesh import Trimesh

from mapping.errors import DataError
from reconstruction.solid import Solid
from tools.dropped_masks import Drop, Part, judge, main


def test_little_of_a_dropped_object_is_free(tabletop: Tabletop) -> None:
    for label in (3, 4):
        legacy = shape_mesh(tabletop.shapes[label - 1])
        solid = Solid(Trimesh(legacy.vertices, legacy.triangles))
        row = judge(Drop("tabletop", tabletop.frame, label, solid))
        assert row is not None
        assert row["inside_free"] <= 0.01
        assert row["measured_free"] <= 0.001
        assert row["inside_other"] > 0.1


@pytest.mark.parametrize(("drops", "labels"), [(1, [1]), (2, [1, 3]), (4, [1, 2, 3, 4]), (9, [1, 2, 3, 4])])
def test_dropped_labels_are_spread_over_all(tabletop: Tabletop, drops: int, labels: list[int]) -> None:
    assert Part(0, 1, drops).labels(tabletop.frame) == labels


def test_pieces_make_one_table(tmp_path: Path) -> None:
    for name, share in (("a", 0.0), ("b", 0.02)):
        row = {"kind": "simulated", "frame": name, "label": 1, "measured_free": 0.0, "inside_other": 1.0}
        figures = {"rows": [{**row, "inside_free": share}], "written_by": [f"piece {name}"]}
        (tmp_path / f"{name}.json").write_text(json.dumps(figures))
    main(add=(tmp_path / "a.json", tmp_path / "b.json"), table=tmp_path / "all.md")
    text = (tmp_path / "all.md").read_text()
    assert "| simulated | 2 | 2 | 1.00% | 2.00% | 1 |" in text
    assert "- piece a\n- piece b" in text
    (tmp_path / "b.json").write_text("{}")
    with pytest.raises(DataError, match=r"b\.json: holds no rows"):
        main(add=(tmp_path / "b.json",))
