"""Which objects may be learned from and which are kept to judge on: by name alone, the same everywhere.

Knows names; knows nothing of meshes, scenes or the prior.
"""

from __future__ import annotations

import re
from hashlib import sha256
from pathlib import PurePosixPath

from mapping.errors import ConfigError

PARTS = ("all", "train", "held-out")
HELD_OUT_SHARE = 0.2
"""Share of groups of objects that are held out."""
GROUP_WORDS = 2
"""Objects whose names begin with the same words are one group: variants of one product may be one shape."""
COLORS = frozenset(
    ["black", "white", "red", "green", "blue", "yellow", "orange", "pink", "purple", "brown", "grey", "gray",
     "silver", "gold", "beige", "turquoise", "cyan", "magenta", "coral", "avocado", "light", "dark",
     "small", "medium", "large", "big"]
)  # fmt: skip
"""Words that tell variants apart and do not count."""


def group_of(name: str) -> str:
    """What an object's name says it is, without folder, numbers, colours and sizes."""
    stem = PurePosixPath(name).name.rsplit(".", 1)[0]
    words = [word for word in re.split(r"[^a-z]+", stem.lower()) if word]
    telling = [word for word in words if word not in COLORS]
    return " ".join((telling or words or [stem.lower()])[:GROUP_WORDS])


def held_out(name: str) -> bool:
    """Whether an object is kept to judge on; all of a group are, or none."""
    digest = int.from_bytes(sha256(group_of(name).encode()).digest()[:8], "big")
    return digest < HELD_OUT_SHARE * 2**64


def in_part(name: str, part: str) -> bool:
    """Whether an object belongs to a part of PARTS; raises ConfigError for another word."""
    if part not in PARTS:
        raise ConfigError(f"part: {part!r} is unknown; valid: {', '.join(PARTS)}")
    return part == "all" or held_out(name) == (part == "held-out")
