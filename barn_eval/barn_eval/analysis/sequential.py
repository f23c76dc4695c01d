"""Two planners compared while trials come in: looks at planned numbers of worlds, with one error over all of them.

The chance of a false alarm is spent over the looks as O'Brien and Fleming's bounds have it (Lan and DeMets 1983,
"Discrete sequential boundaries for clinical trials"). What is spent is counted in patterns of signs of whole worlds, as
in `significance.paired_difference`, and not by the normal distribution.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import special

from barn_eval.analysis.significance import ALPHA, FLIPS, sign_patterns
from barn_eval.analysis.statistics import Columns, difference
from barn_metrics.bootstrap import Interval
from barn_worlds.base.arrays import Floats, Integers

LOOKS = 5  # at a plan
_FUTILE_BELOW = 0.1  # the chance that the plan's last look would still be clear, by what has been seen
Decided = Literal["better", "worse", "futile", "continue", "open"]


@dataclass(frozen=True)
class LookResult:
    """What a look at a plan says of B against A.

    decided: B is "better" or "worse"; "futile" where that would hardly come out any more; "continue" until the next;
    "open" where the last one is not clear. worlds: of the look, 0 before the first. difference: B - A over these, with
    its 95 % interval as if it were the only look.
    """

    decided: Decided
    worlds: int
    difference: Interval


def planned_looks(worlds: int) -> list[int]:
    """Return the numbers of worlds at which a plan of so many is looked at, the last of them the plan."""
    return [
        look for number in range(1, LOOKS + 1) if (look := worlds * number // LOOKS)
    ]


def decide(
    a: Columns,
    b: Columns,
    order: Sequence[int],
    looks: Sequence[int],
    *,
    larger_is_better: bool,
    flips: int = FLIPS,
) -> LookResult:
    """Return what the first look says that decides, or the last that there are worlds for.

    A look decides if its sum of differences is beyond a bound that equal planners reach in 5 % of all plans at most, at
    this look or an earlier one, and if failures not seen would not turn its sign.

    Args:
        a: Trials of one planner.
        b: The same trials of the other, as many in each world.
        order: All worlds of the plan as they come, which must not follow from results.
        looks: Numbers of worlds at which it is looked, ascending; the last is the plan.
        larger_is_better: Which way is better.
        flips: How many patterns of signs there are.
    """
    place = {world: number for number, world in enumerate(order)}
    came: Integers = np.array([place[world] for world in a.worlds.tolist()], np.int64)
    sums = np.bincount(came, b.values - a.values, minlength=looks[-1]).astype(
        np.float64
    )
    patterns = sign_patterns(looks[-1], 0, flips)
    alive, used, crossed = np.ones(len(patterns), bool), 0.0, False
    found = LookResult("continue", 0, Interval(math.nan))
    for look in (one for one in looks if one <= len(np.unique(came))):
        share, own = look / looks[-1], sums[:look]
        sizes = np.where(alive, np.abs(patterns[:, :look] @ own), -1.0)
        # The patterns of largest sums cross, as many as may have by now; of equal sums all or none.
        most = np.sort(sizes)[::-1][math.floor((_spent(share) - used) * len(sizes))]
        crossing = sizes > most
        crossed, used, alive = (
            crossed or bool(crossing[0]),
            used + float(crossing.mean()),
            alive & ~crossing,
        )
        there = np.flatnonzero(came < look)
        plain = difference(b.at(there), a.at(there), flips=flips)
        decided: Decided = "open" if look == looks[-1] else "continue"
        if crossed and plain.p <= ALPHA:
            decided = (
                "better"
                if (plain.interval.estimate > 0.0) == larger_is_better
                else "worse"
            )
        elif (
            decided == "continue"
            and share >= 0.5
            and _chance_left(own, share) < _FUTILE_BELOW
        ):
            decided = "futile"
        found = LookResult(decided, look, plain.interval)
        if decided != "continue":
            break
    return found


def _spent(share: float) -> float:
    """Return how much of ALPHA may be spent when that share of the worlds is there."""
    return 2.0 * float(special.ndtr(special.ndtri(ALPHA / 2.0) / math.sqrt(share)))


def _chance_left(sums: Floats, share: float) -> float:
    """Return the chance that the last look is clear if the rest is like that share: conditional power, by the trend."""
    size = math.sqrt(float(sums @ sums))
    z = abs(float(sums.sum())) / size if size > 0.0 else 0.0
    return float(
        special.ndtr(
            (z / math.sqrt(share) + special.ndtri(ALPHA / 2.0)) / math.sqrt(1.0 - share)
        )
    )
