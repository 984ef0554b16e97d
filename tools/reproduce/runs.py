"""What the reproduce commands share: resumable runs, summaries over seeds, tables and figures on disk."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from mapping.errors import ConfigError
from mapping.files import temporary_beside
from tools.stopwatch import Stopwatch

T = TypeVar("T")

LARGE_FIGURE = 200_000
"""A figure above this size [bytes] is written with a palette."""


def timed(
    name: str, compute: Callable[[], T], least_s: float = 1.0, most: int = 9
) -> tuple[T, dict[str, float]]:
    """compute()'s result and its Stopwatch figures: medians of repeats until `least_s` [s] or `most` repeats.

    One call of some milliseconds would mostly show what else the machine did.
    """
    repeats: list[dict[str, float]] = []
    whole = time.perf_counter()
    while not repeats or (len(repeats) < most and time.perf_counter() - whole < least_s):
        watch = Stopwatch()
        result = compute()
        repeats.append(watch.figures(name))
    return result, {key: float(np.median([found[key] for found in repeats])) for key in repeats[0]}


def spread(values: Sequence[float]) -> dict[str, float]:
    """{"mean", "std", "median"} of the values; the std of one value is 0."""
    return {
        "mean": float(np.mean(values)),
        "std": float(np.std(values)),
        "median": float(np.median(values)),
    }


def summarise(runs: Sequence[dict[str, float]], keys: Sequence[str]) -> dict[str, dict[str, float]]:
    """The spread of each key over the runs."""
    return {key: spread([run[key] for run in runs]) for key in keys}


def seconds(value: float) -> str:
    """A time [s] with three figures, never in powers of ten."""
    return np.format_float_positional(value, precision=3, fractional=False, trim="-")


def save_figure(figure: Any, path: Path, dots_per_inch: int = 100) -> None:
    """Write a matplotlib figure as PNG, whole or not at all; a large one gets a palette of 256 colours."""
    import io

    from PIL import Image

    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dots_per_inch, bbox_inches="tight")
    picture = Image.open(buffer).convert("RGB")
    if buffer.getbuffer().nbytes > LARGE_FIGURE:
        picture = picture.quantize(256)
    path.parent.mkdir(parents=True, exist_ok=True)
    with temporary_beside(path) as unfinished:
        picture.save(unfinished, format="PNG", optimize=True)


def check_choices(chosen: Sequence[str], valid: Sequence[str], what: str) -> None:
    """Raise ConfigError for a name that is not valid, or when none was chosen."""
    wrong = [name for name in chosen if name not in valid]
    if wrong or not chosen:
        raise ConfigError(f"{what}: {', '.join(wrong) or 'none given'}; choose from {', '.join(valid)}")
