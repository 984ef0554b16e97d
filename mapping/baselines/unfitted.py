"""Maps that were asked before they were fitted say so. Knows attributes only."""

from __future__ import annotations

from typing import TYPE_CHECKING, NoReturn

from mapping.errors import DataError


class NotFittedError(DataError, AttributeError):
    """A map was asked for what only `fit` gives it."""


class SaysUnfitted:
    """Base of maps whose learned state appears in `fit`."""

    if not TYPE_CHECKING:  # a type checker would take every name for an attribute

        def __getattr__(self, name: str) -> NoReturn:
            if name.startswith("__"):
                raise AttributeError(name)
            raise NotFittedError(
                f"this {type(self).__name__} is not fitted yet, or has no {name}; call fit before asking it"
            )
