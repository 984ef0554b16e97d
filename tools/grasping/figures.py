"""From attempts to figures: success with intervals, share cleared, differences, coverage.

Knows plain values; knows nothing of physics.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np

Result = dict[str, Any]
"""What play() gives for one round, with its `settings`."""
Z = 1.96
"""Of a 95 % interval."""
HIDDEN = (0.1, 0.4)
"""Shares of a target that others hide: bounds between "in view", "partly hidden" and "mostly hidden"."""
COVERAGES = (1.0, 0.8, 0.6, 0.4, 0.2)
"""Shares of attempts, those with the best scores, whose success is told."""
DRAWS, SEED = 2000, 0
"""Of the bootstrap over rounds."""


def wilson(successes: int, count: int) -> tuple[float, float]:
    """95 % interval of a share of independent trials (Wilson's score interval); (0, 1) for none."""
    if count == 0:
        return 0.0, 1.0
    share, spread = successes / count, Z**2 / count
    middle = (share + spread / 2) / (1 + spread)
    half = Z * np.sqrt(share * (1 - share) / count + spread / (4 * count)) / (1 + spread)
    # Rounding must not leave the share outside of its interval.
    return min(float(middle - half), share), max(float(middle + half), share)


def summarise(results: dict[str, list[Result]]) -> dict[str, Any]:
    """Condition -> results of its rounds, to conditions.<name> and differences.<name>.<against>."""
    conditions = {name: condition_figures(found) for name, found in results.items() if found}
    differences = {
        name: {
            other: difference(found, results[other]) for other in results if other != name and results[other]
        }
        for name, found in results.items()
        if found
    }
    return {"conditions": conditions, "differences": differences}


def condition_figures(results: Sequence[Result]) -> dict[str, Any]:
    """Figures of one condition over its rounds."""
    tries = [attempt for result in results for attempt in result["attempts"]]
    figures = _rate(tries)
    objects, cleared = (sum(result[key] for result in results) for key in ("objects", "cleared"))
    low, high = wilson(cleared, objects)
    groups: dict[str, list[Result]] = defaultdict(list)
    for result in results:
        groups[result["settings"]["group"]].append(result)
    bins = np.digitize([attempt["hidden"] for attempt in tries], HIDDEN) if tries else np.zeros(0, int)
    return {
        **figures,
        "cleared": cleared / max(objects, 1),
        "cleared_low": low,
        "cleared_high": high,
        "objects": objects,
        "rounds": len(results),
        "reasons": dict(Counter(_reason(attempt) for attempt in tries)),
        "ended": dict(Counter(result["ended"] for result in results)),
        "by_group": {
            name: {
                **_rate([attempt for result in found for attempt in result["attempts"]]),
                "cleared": sum(r["cleared"] for r in found) / max(sum(r["objects"] for r in found), 1),
            }
            for name, found in sorted(groups.items())
        },
        "by_hidden": {
            name: _rate([tries[i] for i in np.flatnonzero(bins == number)])
            for number, name in enumerate(("in view", "partly hidden", "mostly hidden"))
        },
        "coverage": coverage(tries),
        "plan_s": float(np.median([attempt["plan_s"] for attempt in tries])) if tries else None,
    }


def coverage(tries: Sequence[dict[str, Any]]) -> list[dict[str, float]]:
    """Success among the attempts with the best scores: what abstaining from the others would give."""
    ranked = sorted(tries, key=lambda attempt: -attempt["score"])
    found = []
    for share in COVERAGES:
        best = ranked[: round(share * len(ranked))]
        if best:
            rate = _rate(best)
            found.append({"share": share, "bound": best[-1]["score"], **rate})
    return found


def difference(results: Sequence[Result], against: Sequence[Result]) -> dict[str, float]:
    """Success minus that of another condition on the rounds that both played, with a 95 % interval from a
    bootstrap over rounds."""
    mine, theirs = ({r["settings"]["round"]: r for r in found} for found in (results, against))
    shared = sorted(mine.keys() & theirs.keys())
    counts = np.array([[*_counts(mine[name]), *_counts(theirs[name])] for name in shared], float).reshape(
        -1, 4
    )
    if not len(counts) or not counts[:, 1].sum() or not counts[:, 3].sum():
        return {"rounds": len(counts)}
    drawn = np.random.default_rng(SEED).integers(len(counts), size=(DRAWS, len(counts)))
    sums = counts[drawn].sum(1)
    gains = sums[:, 0] / np.maximum(sums[:, 1], 1) - sums[:, 2] / np.maximum(sums[:, 3], 1)
    total = counts.sum(0)
    low, high = np.quantile(gains, [0.025, 0.975])
    return {
        "rounds": len(shared),
        "success": float(total[0] / total[1] - total[2] / total[3]),
        "low": float(low),
        "high": float(high),
    }


def _counts(result: Result) -> tuple[int, int]:
    return sum(attempt["success"] for attempt in result["attempts"]), len(result["attempts"])


def _rate(tries: Sequence[dict[str, Any]]) -> dict[str, Any]:
    successes = sum(bool(attempt["success"]) for attempt in tries)
    low, high = wilson(successes, len(tries))
    share = successes / len(tries) if tries else None
    return {"attempts": len(tries), "success": share, "low": low, "high": high}


def _reason(attempt: dict[str, Any]) -> str:
    return f"{attempt['reason']} with {attempt['touched']}" if attempt["touched"] else attempt["reason"]
