"""The house keeps its order: no circles, imports only downwards, heavy packages late, short files."""

import ast
from pathlib import Path

import pytest

from tools.import_map import ROOMS, circles, graph, imported, modules, names

ROOT = Path(__file__).parents[1]
BELOW = {
    "mapping": set(),
    "perception": {"mapping"},
    "reconstruction": {"mapping", "perception"},
    "sim_scenes": {"mapping", "perception", "reconstruction"},
    "tools": {"mapping", "perception", "reconstruction", "sim_scenes"},
    "contramap": {"mapping", "perception", "reconstruction"},
}
"""Package -> the packages that it may import."""
HEAVY = {"open3d", "pybullet", "rerun", "ray", "matplotlib", "sklearn", "mujoco"}
"""Packages that are imported where they are used; torch may stand at the top within `mapping` and `prior`."""
MOST_LINES = 300


def test_no_circles():
    assert circles(graph()) == []


def test_a_circle_would_be_found():
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}}) == [["a", "b", "c"]]


def test_imports_lead_downwards():
    upwards = [
        f"{name} -> {target}"
        for name, targets in graph().items()
        for target in targets
        if (top := target.split(".")[0]) != (own := name.split(".")[0]) and top not in BELOW[own]
    ]
    assert upwards == []


def test_heavy_packages_are_imported_within_functions():
    early = []
    for name, path in modules().items():
        for statement, inside in imported(ast.parse(path.read_text())):
            for full in names(statement):
                top = full.split(".")[0]
                torch = top == "torch" and not name.startswith(("mapping.", "reconstruction.prior."))
                if not inside and (top in HEAVY or torch):
                    early.append(f"{name}: {top}")
    assert sorted(set(early)) == ALLOWED


ALLOWED = [
    "tools.prior_batches: torch",
    "tools.prior_fit: torch",
    "tools.prior_scores: torch",
    "tools.train_prior: torch",
]
"""Modules that are imported only when a map is evaluated or trained, after mapping has loaded torch."""


@pytest.mark.parametrize("room", ROOMS)
def test_no_file_is_long(room):
    long = {
        path.relative_to(ROOT).as_posix(): lines
        for path in (ROOT / room).rglob("*.py")
        if (lines := len(path.read_text().splitlines())) > MOST_LINES
    }
    assert long == {}
