"""Long measurements in pieces: rows that earlier runs wrote as JSON, and the commands that made them."""

from __future__ import annotations

from collections.abc import Sequence
from json import loads
from pathlib import Path
from typing import Any

from mapping.errors import DataError


def earlier(paths: Sequence[Path]) -> tuple[list[dict[str, Any]], list[str]]:
    """All rows of earlier runs, and the lines that say where they come from.

    Raises DataError where a file holds none.
    """
    rows: list[dict[str, Any]] = []
    written_by: list[str] = []
    for path in paths:
        try:
            figures = loads(path.read_text())
            rows += figures["rows"]
            written_by += figures["written_by"]
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise DataError(f"{path}: holds no rows ({error!r}); give files that --json wrote") from error
    return rows, written_by


def named_pieces(written_by: Sequence[str]) -> list[str]:
    """Lines of markdown that name the pieces, where there are several."""
    if len(written_by) < 2:
        return []
    return ["The pieces:", "", *(f"- {line}" for line in written_by), ""]
