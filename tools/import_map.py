"""Which module imports which, read from the source: lists circles and draws docs/figures/imports.png.

Knows files and their import statements; runs none of them. Imports for type checkers alone do not count, for
they never happen; imports within functions do.
"""

from __future__ import annotations

import ast
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
ROOMS = ("mapping", "perception", "reconstruction", "sim_scenes", "tools")
"""The packages, lowest first."""


def modules(root: Path = ROOT) -> dict[str, Path]:
    """Dotted name -> file of every module."""
    found = {}
    for path in [
        root / "contramap.py",
        *(file for room in ROOMS for file in sorted((root / room).rglob("*.py"))),
    ]:
        parts = path.relative_to(root).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imported(tree: ast.AST) -> Iterator[tuple[ast.Import | ast.ImportFrom, bool]]:
    """Import statements, and whether each stands within a function; those for type checkers are left out."""

    def walk(node: ast.AST, inside: bool) -> Iterator[tuple[ast.Import | ast.ImportFrom, bool]]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
                continue
            if isinstance(child, ast.Import | ast.ImportFrom):
                yield child, inside
            yield from walk(child, inside or isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef))

    yield from walk(tree, False)


def names(statement: ast.Import | ast.ImportFrom) -> list[str]:
    """The dotted names that a statement may mean: `from a import b` is a.b, or a."""
    if isinstance(statement, ast.Import):
        return [alias.name for alias in statement.names]
    return [f"{statement.module}.{alias.name}" for alias in statement.names]


def graph(root: Path = ROOT) -> dict[str, set[str]]:
    """Module -> the project's modules that it imports, within functions too."""
    files = modules(root)
    arrows: dict[str, set[str]] = {}
    for name, path in files.items():
        arrows[name] = set()
        for statement, _ in imported(ast.parse(path.read_text())):
            for full in names(statement):
                target = full if full in files else full.rpartition(".")[0]
                if target in files and target != name:
                    arrows[name].add(target)
    return arrows


def circles(arrows: dict[str, set[str]]) -> list[list[str]]:
    """Groups of modules that reach each other; empty when there is no circle."""
    import networkx

    components = networkx.strongly_connected_components(networkx.DiGraph(arrows))
    return sorted(sorted(group) for group in components if len(group) > 1)


def room(module: str) -> str:
    """The room of a module: its package, and the folder within it if it has one."""
    parts = module.split(".")
    return ".".join(parts[:2] if len(parts) > 2 else parts[:1])


def draw(path: Path) -> None:
    """Write a picture of the rooms: an arrow leads from each to the ones it imports, thick where often."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    arrows = graph()
    counts = Counter(
        (room(a), room(b)) for a, targets in arrows.items() for b in targets if room(a) != room(b)
    )
    rooms = sorted({room(name) for name in arrows} - {"contramap"})
    rows = {top: [name for name in rooms if name.split(".")[0] == top] for top in ROOMS}
    place = {}
    for level, top in enumerate(ROOMS):
        for index, name in enumerate(rows[top]):
            place[name] = ((index + 0.5) / len(rows[top]), level + 0.22 * (index % 2))
    figure, axes = plt.subplots(figsize=(12, 8), layout="constrained")
    for (a, b), count in counts.items():
        if a in place and b in place:
            style = {"arrowstyle": "->", "color": "#4060a0", "alpha": 0.45, "lw": 0.5 + 0.5 * count**0.5}
            style |= {"connectionstyle": "arc3,rad=0.12", "shrinkA": 16, "shrinkB": 16}
            axes.annotate("", place[b], place[a], arrowprops=style)
    for name, (x, y) in place.items():
        size = sum(room(module) == name for module in arrows)
        box = {"boxstyle": "round,pad=0.4", "fc": "#f4f6fa", "ec": "#30405a"}
        axes.text(x, y, f"{name}\n{size} files", ha="center", va="center", fontsize=9, bbox=box)
    axes.set(xlim=(0, 1), ylim=(-0.4, len(ROOMS) - 0.3))
    axes.axis("off")
    axes.set_title("Who imports whom: arrows lead to what is imported", fontsize=12)
    figure.savefig(path, dpi=100, metadata={"Software": None})
    plt.close(figure)


if __name__ == "__main__":
    for group in circles(graph()):
        print("circle:", " ".join(group))
    draw(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "figures" / "imports.png")
