"""Verdicts on a figure by its interval."""

from __future__ import annotations

from barn_metrics.bootstrap import Interval

HOLDS, FAILS, OPEN = "holds", "does not hold", "not decided"


def above(interval: Interval, value: float = 0.0) -> str:
    """Return the verdict on whether a figure is above a value."""
    if interval.low is None or interval.high is None:
        return OPEN
    return HOLDS if interval.low > value else FAILS if interval.high < value else OPEN


def below(interval: Interval, value: float = 0.0) -> str:
    """Return the verdict on whether a figure is below a value."""
    return {HOLDS: FAILS, FAILS: HOLDS, OPEN: OPEN}[above(interval, value)]


def contains(interval: Interval, value: float) -> bool:
    """Tell whether a value lies within an interval."""
    return interval.low is not None and interval.high is not None and interval.low <= value <= interval.high
