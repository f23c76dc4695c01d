"""What the results of a run say together: rates and means with their uncertainty."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from barn_eval.analysis.statistics import mean_over_trials, repetition_spread, wilson
from barn_eval.trials.outcome import Outcome
from barn_eval.trials.result import TrialResult
from barn_metrics.bootstrap import Interval


@dataclass(frozen=True)
class Summary:
    """Figures of the trials of one planner; intervals are of 95 %.

    success_time_s: over the successes only. normalised_time_s_per_m: over all trials as the protocol counts them;
    spread_s_per_m: its standard deviation over a world's trials, averaged over worlds, as the paper gives it.
    """

    trials: int
    worlds: int
    outcomes: dict[str, int]
    success_rate: Interval
    success_time_s: Interval
    scored_time_s: Interval
    normalised_time_s_per_m: Interval
    spread_s_per_m: float
    challenge: Interval
    challenge_2022: Interval


def summarise(results: Sequence[TrialResult]) -> Summary:
    """Return the summary of at least one result."""
    worlds = np.array([result.world for result in results], np.int64)

    def mean(value: Callable[[TrialResult], float | None]) -> Interval:
        values = [value(result) for result in results]
        return mean_over_trials(np.array([np.nan if one is None else one for one in values]), worlds)

    outcomes = Counter(result.outcome for result in results)
    normalised = np.array([result.scores.normalised_time_s_per_m for result in results])
    return Summary(
        trials=len(results),
        worlds=len(np.unique(worlds)),
        outcomes={outcome.value: outcomes[outcome] for outcome in Outcome if outcomes[outcome]},
        success_rate=wilson(outcomes[Outcome.SUCCESS], len(results)),
        success_time_s=mean(lambda one: one.scores.traversal_time_s if one.scores.success else None),
        scored_time_s=mean(lambda one: one.scores.scored_time_s),
        normalised_time_s_per_m=mean(lambda one: one.scores.normalised_time_s_per_m),
        spread_s_per_m=repetition_spread(normalised, worlds),
        challenge=mean(lambda one: one.scores.challenge),
        challenge_2022=mean(lambda one: one.scores.challenge_2022),
    )
