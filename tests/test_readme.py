"""README and BENCHMARK.md keep their word: commands and snippets run as written, links and names exist."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tools.cli import COMMANDS, GROUPS, main

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
BENCHMARK = (ROOT / "BENCHMARK.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", README, re.M | re.S)


@pytest.fixture(scope="module")
def home(tmp_path_factory) -> Path:
    """A checkout as `make demo` leaves it: an environment to activate, and demo_out."""
    home = tmp_path_factory.mktemp("checkout")
    (home / ".venv" / "bin").mkdir(parents=True)
    command = home / ".venv" / "bin" / "contramap"
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m tools.cli "$@"\n')
    command.chmod(0o755)
    (home / ".venv" / "bin" / "activate").write_text(f'export PATH="{command.parent}:$PATH"\n')
    assert main(["demo", "--objects", "shipped", "--out", str(home / "demo_out")]) == 0
    return home


def run(arguments: list[str], home: Path) -> str:
    """Output of a command in that folder that must succeed; there is no display for it."""
    hidden = ("DISPLAY", "WAYLAND_DISPLAY")
    environment = {key: value for key, value in os.environ.items() if key not in hidden}
    environment["PYTHONPATH"] = str(ROOT)
    done = subprocess.run(arguments, cwd=home, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_every_command_runs_as_written(home):
    script = "set -e\n" + "\n".join(blocks("bash"))
    output = run(["bash", "-c", script], home)
    assert "result: result" in output
    for name in ("result/scene.json", "run.rrd", "from_files/overview.png"):
        assert (home / name).is_file()


@pytest.mark.parametrize("index", range(len(blocks("python"))))
def test_every_snippet_runs_as_written(home, index):
    run([sys.executable, "-c", blocks("python")[index]], home)
    assert (home / ("first.ply", "map.npz")[index]).is_file()


def test_make_knows_every_target_that_is_named():
    targets = set(re.findall(r"\bmake ([a-z-]+)", README))
    assert targets >= {"demo", "test"}
    makefile = (ROOT / "Makefile").read_text()
    for target in targets:
        assert re.search(rf"^{target}:", makefile, re.M), target


@pytest.mark.parametrize("text", [README, BENCHMARK], ids=["README", "BENCHMARK"])
def test_every_command_and_file_that_is_named_exists(text):
    named = re.findall(r"(?:^ *|`|=\d )contramap ([a-z]+)(?: ([a-z]+))?", text, re.M)
    assert len(named) > 5
    for first, second in named:
        assert first in COMMANDS, first
        if first in GROUPS:
            assert second in GROUPS[first], f"{first} {second}"
    for module in re.findall(r"python -m ([a-z_.]+)", text):
        assert (ROOT / (module.replace(".", "/") + ".py")).is_file(), module
    for link in re.findall(r"\]\(([^)#]+)\)", text):
        assert link.startswith("http") or (ROOT / link).exists(), link
    for path in re.findall(
        r"`((?:docs|tests|tools|mapping|perception|reconstruction|sim_scenes)/[\w/.]*)`", text
    ):
        assert (ROOT / path).exists(), path


@pytest.mark.parametrize(("text", "most"), [(README, 150), (BENCHMARK, 200)], ids=["README", "BENCHMARK"])
def test_they_stay_short(text, most):
    assert len(text.splitlines()) <= most
