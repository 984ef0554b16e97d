"""Errors of the command line: one sentence that names what is wrong and the help that tells more."""

from __future__ import annotations

import pytest

from tools.cli import main


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("map", "Missing from contramap map: --out PATH; see contramap map --help"),
        ("view", "Missing from contramap view: RESULT; see contramap view --help"),
        (
            "reproduce toy --out x --see 1",
            "Perhaps you meant: --seed INT; see contramap reproduce toy --help",
        ),
        ("map x --out y --labels a b", "words: b (--labels takes one value); see contramap map --help"),
        ("map x --out y --intrinsics 1 2", "--intrinsics takes 4 values, 2 given; see contramap map --help"),
        ("map --rgb a --depth b --labels a c --out y", "FRAME (c) and --depth were both given"),
        ("demo x", "Unrecognized words: x; see contramap demo --help"),
        ("mapp x", "Available subcommands: demo, map"),
        ("reproduce toyy", "Available subcommands: toy, occupancy"),
    ],
)
def test_the_error_says_what_is_wrong_and_where_help_is(words, sentence, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert main(words.split()) == 2
    said = capsys.readouterr().err
    assert sentence in said
    assert len(said.splitlines()) == 1
    assert said.count("--help") <= 1
