"""Settings that check themselves: a frozen dataclass says of each field what it may be, in its annotation.

Knows annotations and values; knows nothing of what a setting does. Imports nothing that is slow.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass, replace
from math import isfinite
from numbers import Integral, Real
from types import UnionType
from typing import Annotated, Any, ClassVar, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from mapping.errors import ConfigError


@dataclass(frozen=True)
class Range:
    """Bounds of a number, as metadata of its annotation; None: no bound on that side."""

    above: float | None = None
    least: float | None = None
    below: float | None = None
    most: float | None = None

    def holds(self, value: float) -> bool:
        """Whether a number lies within."""
        return (
            (self.above is None or value > self.above)
            and (self.least is None or value >= self.least)
            and (self.below is None or value < self.below)
            and (self.most is None or value <= self.most)
        )

    def __str__(self) -> str:
        words = {"above": "> {:g}", "least": ">= {:g}", "below": "< {:g}", "most": "<= {:g}"}
        given = [(text, getattr(self, name)) for name, text in words.items()]
        return " and ".join(text.format(bound) for text, bound in given if bound is not None)


Length = Annotated[float, Range(above=0, most=100)]
"""A length [m]: of cells, samples or distances between things on tables, or in a room."""
Share = Annotated[float, Range(least=0, most=1)]
"""A share of a whole."""
OpenShare = Annotated[float, Range(above=0, below=1)]
"""A share of a whole that is neither nothing nor all."""
Positive = Annotated[float, Range(above=0)]
"""A number > 0."""
NotNegative = Annotated[float, Range(least=0)]
"""A number >= 0."""
Count = Annotated[int, Range(least=1)]
"""At least one."""
CountOrNone = Annotated[int, Range(least=0)]
"""None, that is 0, or more."""

Config = TypeVar("Config")
_KNOWN: dict[type, dict[str, Any]] = {}


class Checked:
    """Base of settings: every field is held to its annotation when the object is made.

    SECTION names the dataclass in errors. Raises ConfigError that says what would be valid.
    """

    SECTION: ClassVar[str] = ""

    def __post_init__(self) -> None:
        for name, hint in _hints(type(self)).items():
            value = getattr(self, name)
            reason = _fault(value, hint)
            if reason:
                raise ConfigError(f"{self._path(name)} must be {reason}, got {value!r}")

    def _path(self, name: str) -> str:
        return f"{self.SECTION}.{name}".lstrip(".")


def override(config: Config, settings: dict[str, Any], path: str = "") -> Config:
    """A copy of nested settings with some of them changed, such as {"mesh": {"spacing": 0.003}}.

    Raises ConfigError that names the valid fields where a setting is unknown, the valid values where one is
    out of range.
    """
    known = {f.name for f in fields(config)}  # type: ignore[arg-type]
    changed = {}
    for name, value in settings.items():
        where = f"{path}.{name}".lstrip(".")
        if name not in known:
            place = f"in {path}" if path else "sections"
            raise ConfigError(f"unknown setting {where!r}; valid {place}: {', '.join(sorted(known))}")
        current = getattr(config, name)
        if is_dataclass(current):
            if not isinstance(value, dict):
                inner = ", ".join(sorted(f.name for f in fields(current)))
                raise ConfigError(f"{where} is a section, not a value; set one of its fields: {inner}")
            value = override(current, value, where)
        changed[name] = value
    return replace(config, **changed)  # type: ignore[type-var]


def _hints(kind: type) -> dict[str, Any]:
    """The annotation of each field, worked out once a class."""
    if kind not in _KNOWN:
        hints = get_type_hints(kind, include_extras=True)
        _KNOWN[kind] = {field.name: hints[field.name] for field in fields(kind)}
    return _KNOWN[kind]


def _fault(value: Any, hint: Any) -> str | None:
    """What a value must be to fit an annotation, None when it does."""
    if get_origin(hint) is Annotated:
        base, *metadata = get_args(hint)
        reason = _fault(value, base)
        bounds = [m for m in metadata if isinstance(m, Range)]
        if reason:
            return " ".join([reason, *map(str, bounds)])
        outside = [b for b in bounds if value is not None and not b.holds(value)]
        return f"{_fault(object(), base)} {outside[0]}" if outside else None
    if get_origin(hint) is Literal:
        choices = get_args(hint)
        # By type as well: True is no 1.
        fits = any(value == choice and type(value) is type(choice) for choice in choices)
        return None if fits else "one of " + ", ".join(map(str, choices))
    if get_origin(hint) in (Union, UnionType):
        reasons = [_fault(value, part) for part in get_args(hint)]
        return None if None in reasons else " or ".join(r for r in reasons if r)
    if get_origin(hint) is tuple:
        part = get_args(hint)[0]
        fits = isinstance(value, tuple | list) and all(_fault(item, part) is None for item in value)
        return None if fits else f"a list of {_fault(object(), part)}"
    return _fault_of_plain(value, hint)


def _fault_of_plain(value: Any, kind: Any) -> str | None:
    if kind is type(None):
        return None if value is None else "null"
    if kind is bool:
        return None if isinstance(value, bool) else "true or false"
    if kind is int:
        fits = isinstance(value, Integral) and not isinstance(value, bool)
        return None if fits else "a whole number"
    if kind is float:
        number = isinstance(value, Real) and not isinstance(value, bool)
        # A whole number beyond the range of floats is no length either.
        return None if number and abs(value) < 1e300 and isfinite(value) else "a number"
    if kind is str:
        return None if isinstance(value, str) else "a text"
    return None if isinstance(value, kind) else f"a {kind.__name__}"
