"""Work on many points in blocks, so that the intermediate arrays stay in the processor's cache."""

from __future__ import annotations

BLOCK = 16_384
"""Points worked on at a time."""


def blocks(count: int) -> list[slice]:
    """0..count in pieces of at most `BLOCK`."""
    return [slice(start, min(start + BLOCK, count)) for start in range(0, count, BLOCK)]
