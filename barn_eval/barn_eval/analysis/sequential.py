"""Compare two planners while trials come in, with one error rate over all looks.

The chance of a false alarm is spent over the looks by the bounds of O'Brien and Fleming
(Lan and DeMets 1983, "Discrete sequential boundaries for clinical trials"). It is
counted in patterns of signs of whole worlds, as in `significance.paired_difference`,
instead of by the normal distribution.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy

from barn_eval.analysis.significance import ALPHA, FLIPS, sign_patterns
from barn_eval.analysis.statistics import TrialValues, difference
from barn_metrics.bootstrap import Interval
from barn_worlds.base.arrays import Floats, Integers

LOOKS = 5
# A look is futile if the chance that the last look is significant is below this.
_FUTILE_CHANCE = 0.1
# With fewer than half of the worlds, the trend says too little about that chance.
_MIN_FUTILE_SHARE = 0.5

Decision = Literal["better", "worse", "futile", "continue", "open"]


@dataclass(frozen=True)
class LookResult:
    """The result of a look at B compared with A."""

    # B is "better" or "worse"; "futile" if a later look is unlikely to show either;
    # "continue" until the next look; "open" if the last look is not significant.
    decision: Decision

    worlds: int
    """Number of worlds of the look, 0 before the first."""

    difference: Interval
    """B - A over these worlds, with the interval of a single look."""


def plan_looks(worlds: int) -> list[int]:
    """Return the numbers of worlds at which to test, at most five, up to `worlds`."""
    looks = [worlds * number // LOOKS for number in range(1, LOOKS + 1)]
    return [look for look in looks if look]


def decide(
    a: TrialValues,
    b: TrialValues,
    order: Sequence[int],
    looks: Sequence[int],
    *,
    larger_is_better: bool,
    flips: int = FLIPS,
) -> LookResult:
    """Test B against A at each look; return the first that decides, or the last one.

    A look decides if its sum of differences exceeds a bound that equal planners reach in
    at most 5% of all comparisons, at this look or an earlier one, and if failures that
    did not occur would not change the sign.

    Args:
        a: Trials of A.
        b: The same trials of B, as many in each world.
        order: All planned worlds in the order in which they are driven. It must not
            depend on results.
        looks: Numbers of worlds at which to look, ascending; the last is the plan.
        larger_is_better: Whether larger values of the measure are better.
        flips: Number of patterns of signs.
    """
    position = {world: number for number, world in enumerate(order)}
    arrivals: Integers = np.array([position[w] for w in a.worlds.tolist()], np.int64)
    gaps = b.values - a.values
    # Signs are flipped for whole worlds, because trials of a world are not independent.
    sums: Floats = np.bincount(arrivals, gaps, minlength=looks[-1]).astype(np.float64)
    worlds_done = len(np.unique(arrivals))

    patterns = sign_patterns(looks[-1], flips)
    is_alive = np.ones(len(patterns), bool)  # patterns beyond no bound so far
    error_spent = 0.0
    has_crossed = False
    result = LookResult("continue", 0, Interval(math.nan))
    for look in looks:
        if look > worlds_done:
            break
        share = look / looks[-1]
        sizes = np.abs(patterns[:, :look] @ sums[:look])
        sizes = np.where(is_alive, sizes, -1.0)
        # The patterns with the largest sums cross the bound, as many as the error allows
        # so far. Of equal sums, all cross or none.
        allowed = math.floor((_error_to_spend(share) - error_spent) * len(sizes))
        bound = np.sort(sizes)[::-1][allowed]
        is_crossing = sizes > bound
        error_spent += float(is_crossing.mean())
        is_alive &= ~is_crossing
        # The first pattern is the data.
        has_crossed = has_crossed or bool(is_crossing[0])

        done = np.flatnonzero(arrivals < look)
        # Unlike the bound, this test allows for failures that did not occur.
        test = difference(b.at(done), a.at(done), flips=flips)
        decision: Decision = "open" if look == looks[-1] else "continue"
        if has_crossed and test.p <= ALPHA:
            is_better = (test.interval.estimate > 0.0) == larger_is_better
            decision = "better" if is_better else "worse"
        elif (
            decision == "continue"
            and share >= _MIN_FUTILE_SHARE
            and _conditional_power(sums[:look], share) < _FUTILE_CHANCE
        ):
            decision = "futile"
        result = LookResult(decision, look, test.interval)
        if decision != "continue":
            break

    return result


def _error_to_spend(share: float) -> float:
    """Return the error rate allowed once a share (0 to 1) of the worlds is done."""
    return 2.0 * float(
        scipy.special.ndtr(scipy.special.ndtri(ALPHA / 2.0) / math.sqrt(share))
    )


def _conditional_power(sums: Floats, share: float) -> float:
    """Return the probability that the last look is significant if the trend goes on.

    Args:
        sums: Sum of differences of each world that is done (m,).
        share: Share of the planned worlds that is done, below 1.
    """
    size = math.sqrt(float(sums @ sums))
    z = abs(float(sums.sum())) / size if size > 0.0 else 0.0
    # By the trend so far, with B-values (Lan and Wittes 1988).
    expected = z / math.sqrt(share) + scipy.special.ndtri(ALPHA / 2.0)
    return float(scipy.special.ndtr(expected / math.sqrt(1.0 - share)))
