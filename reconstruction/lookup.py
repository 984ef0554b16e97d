"""Finding one of several labelled objects by its name or label, and telling of them in a line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, TypeVar

from mapping.errors import DataError

SHOWN = 6
"""Objects named in a line before the rest is counted."""


class Labelled(Protocol):
    """Anything with a label and a name."""

    @property
    def label(self) -> int: ...
    @property
    def name(self) -> str: ...


Item = TypeVar("Item", bound=Labelled)


def find(objects: Sequence[Item], key: str | int) -> Item:
    """The object of this name or label; DataError, naming the valid ones, when there is none or several."""
    found = [item for item in objects if key in (item.name, item.label)]
    if len(found) == 1:
        return found[0]
    if found:
        labels = ", ".join(str(item.label) for item in found)
        raise DataError(f"{len(found)} objects are named {key!r}; ask for one by its label: {labels}")
    raise DataError(f"no object {key!r} here; there are: {names(objects, len(objects))}")


def names(objects: Sequence[Labelled], most: int = SHOWN) -> str:
    """The objects in a line: "1 mug, 2 bowl and 3 more"."""
    shown = ", ".join(f"{item.label} {item.name}" for item in objects[:most])
    rest = len(objects) - most
    return (shown or "none") + (f" and {rest} more" if rest > 0 else "")


def count(items: Sequence[object], noun: str) -> str:
    """ "1 object", "3 objects"."""
    return f"{len(items)} {noun}{'' if len(items) == 1 else 's'}"
