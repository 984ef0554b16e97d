"""Which views are not asked what is hidden of which objects: those that said nothing new of them.

What they measured counts as any view's does; only their guesses, which those of earlier views stand for, do
not. Knows observations of single views; knows nothing of how it is found that one says nothing new.
"""

from __future__ import annotations

from collections.abc import Sequence

from perception.observation import Observation

SILENT = "silent"
"""Entry of a view's memo: labels of objects about which it is not asked."""


def keep_silent(view: Observation, labels: frozenset[int]) -> None:
    """Do not ask a view about objects with these labels."""
    view.memo[SILENT] = labels


def silent_in(views: Sequence[Observation]) -> dict[int, tuple[int, ...]]:
    """Label of each object -> the views, by their place, that see it and are not asked about it. Where none
    would be left, all are."""
    found: dict[int, tuple[int, ...]] = {}
    for label in dict.fromkeys(item.label for view in views for item in view.objects):
        seeing = [k for k, view in enumerate(views) if any(item.label == label for item in view.objects)]
        silent = [k for k in seeing if label in views[k].memo.get(SILENT, ())]
        found[label] = tuple(silent) if len(silent) < len(seeing) else ()
    return found
