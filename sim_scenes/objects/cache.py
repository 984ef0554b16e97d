"""The folder for what is worth keeping between runs: collision shapes, fetched scans."""

from __future__ import annotations

import os
from pathlib import Path


def cache_dir() -> Path:
    """$CONTRAMAP_CACHE, or ~/.cache/contramap."""
    override = os.environ.get("CONTRAMAP_CACHE")
    return Path(override).expanduser() if override else Path.home() / ".cache" / "contramap"
