"""Means over trials and comparisons of planners, for few worlds and rare failures.

A world is the unit of sampling: functions take one value per trial and the number of its
world. An interval from observed trials ignores failures that by chance did not occur. So
if failures count, limits also include what the mean would be with the share of failures
at either of its own limits. Shares and the test of differences are in `significance`. No
result depends on the order of the trials.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, reduce

import numpy as np

from barn_eval.analysis import significance
from barn_eval.analysis.significance import FLIPS, Components, Difference, Share
from barn_metrics.bootstrap import LEVEL, Interval, bootstrap_interval, spearman
from barn_worlds.base.arrays import Floats, Integers


@dataclass(frozen=True, eq=False)
class TrialValues:
    """A measure's value of each trial, with its world, repetition and penalty."""

    values: Floats
    """Value of each trial (n,)."""

    worlds: Integers
    """Number of each trial's world (n,)."""

    repetitions: Integers
    """Number of each trial among the trials of its world (n,)."""

    failures: Integers = field(default_factory=lambda: np.empty(0, np.int64))
    """1 for each trial that failed, else 0 (n,); empty if failures have no value."""

    as_failure: Floats = field(default_factory=lambda: np.array([]))
    """Value that each trial has, or would have, as a failure (n,)."""

    best: float = math.inf
    """Best possible value."""

    def at(self, positions: Integers) -> "TrialValues":
        """Return a copy with the trials at these indices, in that order."""
        names = ["values", "worlds", "repetitions"]
        if self.counts_failures:
            names += ["failures", "as_failure"]
        return replace(self, **{name: getattr(self, name)[positions] for name in names})

    @property
    def average(self) -> float:
        """Mean of all values, which must be finite; NaN if there is none."""
        if not len(self.values):
            return math.nan
        return float(self.values.mean())

    @property
    def counts_failures(self) -> bool:
        """Whether failures have a value in this measure; then all are finite."""
        return len(self.failures) > 0

    def mean(self) -> Interval:
        """Return the finite values' mean; its limits allow for failures that may occur.

        Limits are clipped to possible values, and None below two worlds.
        """
        trials = self.at(_order_of_finite(self.values, self.worlds))
        interval = mean_interval(trials.values, trials.worlds)
        if trials.counts_failures:
            # No bootstrap or t interval allows for an event that did not occur, so the
            # limits also include the mean at either limit of the share of failures.
            observed = trials.failures_observed
            interval = interval.widen_to(
                *(
                    interval.estimate - trials.cost * (limit - observed.share)
                    for limit in observed.limits
                )
            )
        if interval.low is None or interval.high is None:
            return interval

        low = interval.low
        # A symmetric interval around a small mean would reach below 0.
        if trials.values.min() >= 0.0:
            low = max(0.0, low)
        high = interval.high
        if self.best > 0.0:
            high = min(high, self.best)
        return replace(interval, low=low, high=high)

    def parts(self) -> Components:
        """Return variances between and within worlds, and the cost of unseen failures."""
        components = significance.variance_components(self.values, self.worlds)
        return replace(components, unseen=self.unseen)

    def failure_share(self) -> Interval | None:
        """Return the share of failures with limits; None if failures have no value."""
        if not self.counts_failures:
            return None
        return Interval(self.failures_observed.share, *self.failures_observed.limits)

    @property
    def unseen(self) -> tuple[float, ...]:
        """The cost of a failure as only item if all trials succeeded or all failed, or ()."""
        if len(np.unique(self.failures)) != 1:
            return ()
        return (abs(self.cost),)

    @cached_property
    def failures_observed(self) -> Share:
        """Share of trials that failed, with its effective number of trials."""
        return significance.share_of(self.failures, self.worlds)

    @cached_property
    def cost(self) -> float:
        """Mean of successes minus mean as failures; negative if smaller is better.

        With successes in fewer than two worlds, the best possible value stands for them.
        """
        succeeded = self.failures == 0
        success = self.best
        if len(np.unique(self.worlds[succeeded])) > 1:
            success = float(np.mean(self.values[succeeded]))
        return success - float(np.mean(self.as_failure))

    def excess(self, other: "TrialValues") -> Share:
        """Return the share of failures beyond another's; worlds with fewer count as 0.

        Both must have the same trials.
        """
        _, world = np.unique(self.worlds, return_inverse=True)
        counts = np.bincount(world)
        surplus = np.bincount(world, self.failures - other.failures) / counts
        # Failures that both planners have in a world make no difference.
        share_by_world = np.maximum(0.0, surplus)
        return significance.share_of(share_by_world[world], self.worlds)


def mean_interval(values: Floats, worlds: Integers) -> Interval:
    """Return the mean of finite values; limits allow for skew, None below two worlds.

    The limits are Student's, of the mean's linearization as a ratio, with Hall's
    transformation (1992, "On the removal of skewness by transformation").

    Args:
        values: One value per trial (n,); NaN does not count.
        worlds: Number of each trial's world (n,).
    """
    order = _order_of_finite(values, worlds)
    values = values[order]
    worlds = worlds[order]
    _, world = np.unique(worlds, return_inverse=True)
    sums = np.bincount(world, values).astype(np.float64)
    counts = np.bincount(world).astype(np.float64)

    if not len(sums):
        return Interval(math.nan)
    mean = float(sums.sum() / counts.sum())
    if len(sums) < 2:
        return Interval(mean)
    # Worlds differ in trials, so the mean is a ratio of two sums. Its linearization gives
    # the error (Cochran 1977, Sampling techniques, ch. 6).
    below, above = _limit_distances((sums - mean * counts) / counts.sum())
    return Interval(mean, mean - below, mean + above)


def _limit_distances(residuals: Floats) -> tuple[float, float]:
    """Return how far the 95% limits lie (below, above) an estimate, by its skewness.

    Args:
        residuals: Contribution of each world to the error of the estimate (m,), m > 1.
    """
    worlds = len(residuals)
    spread = float(residuals @ residuals)
    if spread == 0.0:
        return 0.0, 0.0

    # The divisor is m - 1, because residuals are relative to their own mean.
    error = math.sqrt(spread * worlds / (worlds - 1))
    quantile = significance.t_quantile(0.5 + LEVEL / 2.0, worlds - 1)
    cubes = float(np.sum(residuals**3))
    skewness: float = cubes * math.sqrt(worlds) / math.pow(spread, 1.5)
    # The transformation divides by the skewness and would amplify rounding here.
    if math.isclose(skewness, 0.0, abs_tol=1e-9):
        return quantile * error, quantile * error

    def undo_transformation(y: float) -> float:
        """Return the studentized error whose Hall transform is `y`."""
        # The transformation is cubic and monotonic, so it has an exact inverse.
        inner = 1.0 + skewness * (y / math.sqrt(worlds) - skewness / (6.0 * worlds))
        return math.sqrt(worlds) * 3.0 / skewness * (float(np.cbrt(inner)) - 1.0)

    below = undo_transformation(quantile) * error
    # Times of failures make the right tail long, so limits are not symmetric.
    above = -undo_transformation(-quantile) * error
    return below, above


@dataclass(frozen=True)
class Paired:
    """A comparison of A and B on trials of the same worlds and seeds."""

    worlds: int
    trials: int

    mean_a: float
    """Mean of A over those trials."""

    mean_b: float

    difference: Interval
    """Mean of A - B over those trials."""

    p: float
    """Two-sided p-value of the test that flips the sign of whole worlds.

    It is never below the level at which the interval leaves out 0.
    """

    parts: Components
    """Variance of the difference."""

    improvement: Interval
    """Probability that a trial of A is better than one of B in the same world.

    Ties count half; the mean is over worlds.
    """

    failures: tuple[Interval | None, Interval | None] = (None, None)
    """Share of failures of A and of B, None if failures have no value."""

    def test(self) -> Difference:
        """Return the difference A - B and its p-value as a `Difference`."""
        return Difference(self.difference, self.p, self.worlds, self.trials, self.parts)


def repetition_spread(values: Floats, worlds: Integers) -> float:
    """Return the mean of worlds' standard deviations; NaN if no world has two trials.

    This is the paper's +- (Sec. IV): the divisor is n, and worlds with one trial do not
    count.

    Args:
        values: One value per trial (n,); NaN does not count.
        worlds: Number of each trial's world (n,).
    """
    groups = _values_by_world(values, worlds).values()
    spreads = [group.std() for group in groups if len(group) > 1]
    return float(np.mean(spreads)) if spreads else math.nan


def matched_trials(planners: Sequence[TrialValues]) -> list[TrialValues]:
    """Return each planner's trials for which all planners have a value, in one order.

    Trials of one world and repetition belong together, because they have equal noise.
    """
    keys = _trial_keys(planners)
    finite_keys = []
    for trials, trial_keys in zip(planners, keys, strict=True):
        finite_keys.append(trial_keys[np.isfinite(trials.values)])
    # Sorted keys give all planners the same order, which pairs need.
    shared = reduce(np.intersect1d, finite_keys, finite_keys[0])
    matched = []
    for trials, trial_keys in zip(planners, keys, strict=True):
        finite = np.flatnonzero(np.isfinite(trials.values))
        order = finite[np.argsort(trial_keys[finite], kind="stable")]
        # The last of several trials with one key counts.
        places = np.searchsorted(trial_keys[order], shared, side="right") - 1
        matched.append(trials.at(order[places]))
    return matched


def _trial_keys(planners: Sequence[TrialValues]) -> list[Integers]:
    """Return for each planner a number per trial, equal for equal (world, repetition).

    The numbers are ordered by world and then by repetition.
    """
    ranks = []
    for name in ("worlds", "repetitions"):
        numbers = np.concatenate([getattr(trials, name) for trials in planners])
        ranks.append(np.unique(numbers, return_inverse=True)[1])
    world_ranks, repetition_ranks = ranks
    keys = world_ranks * (repetition_ranks.max(initial=0) + 1) + repetition_ranks
    ends = np.cumsum([len(trials.values) for trials in planners])
    return np.split(keys, ends[:-1])


def difference(a: TrialValues, b: TrialValues, flips: int = FLIPS) -> Difference:
    """Return mean, limits and p of A - B over matched trials, wary of unseen failures.

    If failures count, a difference is significant only if it keeps its sign when the
    better planner fails as often as its failures so far allow. By the test alone, a
    quick planner that rarely fails would seem better than a steady one of the same mean
    until a failure occurs. The limits include the differences that failures of either
    planner would make.

    Args:
        a: Trials of A.
        b: The same trials of B, in the same order.
        flips: Number of patterns; see `significance.paired_difference`.
    """
    plain = significance.paired_difference(a.values - b.values, a.worlds, flips)
    if not (a.counts_failures and b.counts_failures and plain.trials):
        return plain

    size = plain.interval.estimate
    p = plain.p
    limits = []
    # B's failures change A minus B with the opposite sign.
    for planner, other, cost in ((a, b, a.cost), (b, a, -b.cost)):
        # Failures that both planners have in a world make no difference.
        excess = planner.excess(other)
        limits.append(size - cost * (excess.limits[1] - excess.share))
        # This planner is the better one, so its failures could turn the sign.
        if size * cost > 0.0:
            p = max(p, excess.p_above(excess.share + size / cost))

    parts = replace(plain.parts, unseen=a.unseen + b.unseen)
    interval = plain.interval.widen_to(*limits)
    return replace(plain, interval=interval, p=p, parts=parts)


def compare_pairs(a: TrialValues, b: TrialValues, *, larger_is_better: bool) -> Paired:
    """Compare A and B on their common trials: difference, p-value and P(A is better).

    The probability of improvement is over every pair of a trial of A and one of B in a
    world (Agarwal et al. 2021, "Deep reinforcement learning at the edge of the
    statistical precipice", with worlds instead of tasks). Its limits are those of
    Clopper and Pearson, for one trial per world.

    Args:
        a: Trials of A.
        b: Trials of B.
        larger_is_better: Whether larger values of the measure are better.
    """
    left, right = matched_trials([a, b])
    test = difference(left, right)
    sides = [left, right]
    if not larger_is_better:
        sides.reverse()
    larger, smaller = (_values_by_world(side.values, side.worlds) for side in sides)
    chances = []
    for world, values in larger.items():
        others = smaller[world]
        below = np.searchsorted(others, values, side="left").sum()
        not_above = np.searchsorted(others, values, side="right").sum()
        # Ties count half.
        chances.append((below + not_above) / 2.0 / (len(values) * len(others)))
    improvement = Interval(math.nan)
    if chances:
        # All worlds have the same weight, however many trials they have.
        share = Share(float(np.mean(chances)), len(chances))
        # Where A is better in all worlds, the signs alone would leave no width.
        improvement = Interval(share.share, *share.limits)
    return Paired(
        worlds=test.worlds,
        trials=test.trials,
        mean_a=left.average,
        mean_b=right.average,
        difference=test.interval,
        p=test.p,
        parts=test.parts,
        improvement=improvement,
        failures=(left.failure_share(), right.failure_share()),
    )


def rank_correlation(
    a: tuple[Floats, Integers], b: tuple[Floats, Integers], seed: int = 0
) -> Interval:
    """Return Spearman's correlation of world means with limits; NaN below three worlds.

    Args:
        a: Values of A and the numbers of their worlds, each (n,).
        b: The same of B (m,); only worlds of both count.
        seed: Seed of the bootstrap.

    Returns:
        The correlation with its interval; NaN for fewer than three worlds.
    """
    a_by_world = _values_by_world(*a)
    b_by_world = _values_by_world(*b)
    shared = sorted(a_by_world.keys() & b_by_world.keys())
    # Two ranks always have a correlation of 1 or -1.
    if len(shared) < 3:
        return Interval(math.nan)

    # Spearman's correlation only uses ranks, and whole numbers are ranked faster.
    ranks = []
    for by_world in (a_by_world, b_by_world):
        means = np.array([by_world[world].mean() for world in shared])
        ranks.append(np.unique(means, return_inverse=True)[1])
    a_ranks, b_ranks = ranks
    return bootstrap_interval(
        lambda sample: spearman(a_ranks[sample], b_ranks[sample]), len(shared), seed
    )


def _values_by_world(values: Floats, worlds: Integers) -> dict[int, Floats]:
    """Return the finite values by world number, each array ascending."""
    order = _order_of_finite(values, worlds)
    numbers, starts = np.unique(worlds[order], return_index=True)
    groups = np.split(values[order], starts[1:])
    return dict(zip(numbers.tolist(), groups, strict=False))


def _order_of_finite(values: Floats, worlds: Integers) -> Integers:
    """Return the indices (m,) of the finite values, by world and then by value."""
    finite = np.flatnonzero(np.isfinite(values))
    # Rounding depends on the order of a sum, and workers finish trials in any order.
    return finite[np.lexsort((values[finite], worlds[finite]))]
