"""Messages of the service: msgpack with arrays, bounded in every way, nothing executable. Knows bytes
only."""

from __future__ import annotations

from math import prod
from typing import Any

import numpy as np

from mapping.errors import DataError

DTYPES = frozenset({"<f4", "<f8", "|u1", "<u2", "<u4", "<i2", "<i4", "<i8", "|b1"})
"""What arrays may hold: plain numbers."""
MOST_AXES = 4
LONGEST_TEXT = 10_000
"""Characters."""
MOST_ENTRIES = 10_000
"""Of a list or dict."""


def encode(content: dict[str, Any]) -> bytes:
    """Bytes of a message; arrays anywhere in it become {dtype, shape, data}."""
    import msgpack

    packed: bytes = msgpack.packb(content, default=_pack)
    return packed


def decode(content: bytes, largest: int) -> dict[str, Any]:
    """The dict in a message of at most `largest` bytes, arrays as read-only numpy arrays.

    Raises DataError that says what is wrong with it.
    """
    import msgpack

    if len(content) > largest:
        raise DataError(f"the message has {len(content)} bytes, more than the {largest} this server takes")
    try:
        found = msgpack.unpackb(
            content,
            object_hook=_unpack,
            strict_map_key=True,
            max_str_len=LONGEST_TEXT,
            max_bin_len=largest,
            max_array_len=MOST_ENTRIES,
            max_map_len=MOST_ENTRIES,
            max_ext_len=0,
        )
    except DataError:
        raise
    except Exception as error:  # msgpack raises many types for broken bytes
        raise DataError(f"not a msgpack message of this service ({type(error).__name__}: {error})") from error
    if not isinstance(found, dict):
        raise DataError(f"a message is a map with 'request' and its fields, got {type(found).__name__}")
    return found


def _pack(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        value = np.ascontiguousarray(value)
        return {"dtype": value.dtype.str, "shape": list(value.shape), "data": value.tobytes()}
    raise TypeError(f"cannot send a {type(value).__name__}")


def _unpack(value: dict[str, Any]) -> Any:
    if set(value) != {"dtype", "shape", "data"}:
        return value
    dtype, shape, data = value["dtype"], value["shape"], value["data"]
    if dtype not in DTYPES:
        raise DataError(f"arrays of {dtype!r} are not taken; valid: {', '.join(sorted(DTYPES))}")
    plain = isinstance(shape, list) and len(shape) <= MOST_AXES
    if not plain or not all(type(n) is int and n >= 0 for n in shape) or not isinstance(data, bytes):
        raise DataError(f"an array needs shape, at most {MOST_AXES} whole numbers, and data, bytes")
    if prod(shape) * np.dtype(dtype).itemsize != len(data):
        raise DataError(f"an array of {dtype} and shape {shape} does not have {len(data)} bytes")
    return np.frombuffer(data, dtype).reshape(shape)
