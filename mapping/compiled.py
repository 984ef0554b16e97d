"""Loops compiled to machine code: for work whose next step depends on the last, which arrays cannot express.

Knows how functions are compiled and where the result is kept; knows nothing of what they work out. Compiled
loops hold no lock of the interpreter, so threads run them side by side. The first call of a function on a
machine compiles it, for a second or so; the result is kept beside its file, or in the user's cache folder.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba

# Where it is off (the default), sums over a few neighbouring numbers are worked out one by one.
numba.config.SLP_VECTORIZE = 1  # type: ignore[attr-defined]


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same function of numbers and arrays, as machine code."""
    try:
        return numba.njit(function, cache=True, nogil=True, error_model="numpy")
    except RuntimeError:  # no folder can be written: compiled anew in each process
        return numba.njit(function, nogil=True, error_model="numpy")
