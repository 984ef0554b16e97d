"""Results that are kept: a command that was stopped goes on where it was, and makes again what is broken.

Knows JSON files; knows nothing of what is measured.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

from mapping.errors import DataError
from mapping.files import write_atomically
from mapping.guarded_files import read_json


def read_kept(path: Path, keys: Collection[str], **equal: Any) -> dict[str, Any] | None:
    """The result kept in a file; None when it is missing, broken, or of another version.

    keys: what it must hold; equal: values that some of its entries must have.
    """
    if not path.is_file():
        return None
    try:
        content = read_json(path)
    except DataError:
        return None
    if not isinstance(content, dict) or not all(key in content for key in keys):
        return None
    return content if all(content.get(key) == value for key, value in equal.items()) else None


def cached_run(
    path: Path, settings: dict[str, Any], compute: Callable[[], dict[str, Any]], overwrite: bool = False
) -> dict[str, Any]:
    """The result at `path` when it was computed with these settings; else compute it and write it there.

    So a command that was cut off goes on where it stopped, and changed settings never mix with old runs.
    """
    if not overwrite:
        settings_read_back = json.loads(json.dumps(settings))
        stored = read_kept(path, ("settings", "result"), settings=settings_read_back)
        if stored is not None:
            return stored["result"]
    result = compute()
    path.parent.mkdir(parents=True, exist_ok=True)
    content = {"settings": settings, "result": result}
    write_atomically(path, (json.dumps(content, indent=2) + "\n").encode())
    return result
