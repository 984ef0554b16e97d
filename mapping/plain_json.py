"""Values as JSON has them. Knows Python's and NumPy's types; knows nothing of what they mean."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np


def plain(value: Any) -> Any:
    """Arrays, tuples, paths and numpy numbers as JSON types; NaN and infinity as null."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    return value
