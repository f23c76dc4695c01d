"""Checks of intervals and tests: what simulations count and how often it may come."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
from simulated_trials import (
    CORRELATION,
    REPETITIONS,
    SCORE,
    SCORE_WORLD_SPREAD,
    draw_equal_planners,
    draw_failure_chances,
    draw_pair,
    draw_planner,
    draw_scores,
    draw_slow_pair,
    draw_trials,
)

from barn_eval.analysis.sequential import LOOKS, LookResult, decide, plan_looks
from barn_eval.analysis.significance import ALPHA, paired_difference, proportion
from barn_eval.analysis.statistics import (
    TrialValues,
    compare_pairs,
    difference,
    mean_interval,
)
from barn_eval.analysis.verdict import rank
from barn_metrics.bootstrap import Interval

BOARD_PLANNERS = 8
# Patterns of signs: enough to decide whether p is below 5 %; reports draw 10 000.
_FLIPS = 2000
# Difference of means that is to be detected.
_DIFFERENCE = 0.1

# Allowed shares of simulations in which an event comes.
_COVERAGE = (0.93, 0.97)
_COVERAGE_AT_LEAST = (0.93, 1.0)
_FALSE_ALARMS = (0.0, 0.06)
_DETECTIONS = (0.5, 1.0)

_COVERS = "the 95 % interval of a {} covers the truth"
_WITH_FAILURES = "{0} worlds x {1}, {2:g} % failures"
_ALIKE = f"{{0}} worlds x {REPETITIONS}"
_PLAN = f"{{0}} worlds, {LOOKS} looks, {{1:g}} % failures"
_IMPROVEMENT = f"{100.0 * _DIFFERENCE:g} %"

# Numbers of worlds and repetitions.
_SIZES = tuple(product((10, 20, 50, 100, 300), (1, 5)))
_WORLDS = ((20,), (50,), (300,))
_PLANS = ((100, 2.0), (300, 2.0), (300, 5.0))


@dataclass(frozen=True)
class CheckGroup:
    """Checks of one kind in several settings."""

    # What is counted, in words. Randomness comes from it: another text, other draws.
    event: str
    # Least and greatest share of simulations in which the event may come.
    target: tuple[float, float]
    # Text of a setting, with places for its numbers.
    setting_text: str
    # Simulates a setting, given its numbers and a generator; returns whether the event
    # came, or for how large a share.
    simulate: Callable[..., float]
    # Numbers of each setting.
    settings: Sequence[tuple[float, ...]]


def _covers(interval: Interval, truth: float) -> bool:
    if interval.low is None or interval.high is None:
        return False
    return interval.low <= truth <= interval.high


def _is_clear(pair: Sequence[TrialValues]) -> bool:
    return difference(pair[0], pair[1], flips=_FLIPS).p <= ALPHA


def _share_covers(
    worlds: int,
    repetitions: int,
    correlation: float,
    truth: float,
    generator: np.random.Generator,
    *,
    of_failures: bool = False,
    of_pairs: bool = False,
) -> bool:
    """Draw trials, of failures where these are rare, or of pairs that A may win."""
    world = np.repeat(np.arange(worlds), repetitions)
    share = 1.0 - truth if of_failures else truth
    chances = draw_failure_chances(share, correlation, worlds, generator)[world]
    events = (generator.random(len(world)) < chances).astype(np.int64)
    if of_failures:
        events = 1 - events
    if not of_pairs:
        return _covers(proportion(events, world), truth)
    repetition = np.tile(np.arange(repetitions), worlds)
    first = TrialValues(events.astype(np.float64), world, repetition)
    second = replace(first, values=np.full(len(world), 0.5))
    pairs = compare_pairs(first, second, larger_is_better=True)
    return _covers(pairs.improvement, truth)


def _mean_of_successes_covers(
    worlds: int, repetitions: int, percent: float, generator: np.random.Generator
) -> bool:
    planner = draw_planner(worlds, repetitions, percent, generator)
    successes = np.where(planner.failures == 1, np.nan, planner.values)
    return _covers(mean_interval(successes, planner.worlds), SCORE)


def _success_difference_covers(
    worlds: int,
    repetitions: int,
    first_percent: float,
    second_percent: float,
    generator: np.random.Generator,
) -> bool:
    # Chances of both planners are drawn before any of their trials.
    chances = [
        draw_failure_chances(percent / 100.0, CORRELATION, worlds, generator)
        for percent in (first_percent, second_percent)
    ]
    first, second = (
        draw_trials(
            repetitions,
            failure_chances,
            lambda world: np.ones(len(world)),
            generator,
            0.0,
            1.0,
        )
        for failure_chances in chances
    )
    interval = difference(first, second, flips=_FLIPS).interval
    return _covers(interval, (second_percent - first_percent) / 100.0)


def _test_of_signs_differs(worlds: int, generator: np.random.Generator) -> bool:
    first, second = draw_equal_planners(2, worlds, generator)
    differences = first.values - second.values
    return paired_difference(differences, first.worlds, flips=_FLIPS).p <= ALPHA


def _board_differs(worlds: int, generator: np.random.Generator) -> bool:
    """Rank equal planners by a measure that has no value for failures.

    There the test of signs alone decides.
    """
    effects = generator.normal(0.0, SCORE_WORLD_SPREAD, worlds)
    planners = {}
    for number in range(BOARD_PLANNERS):
        scores = draw_scores(0.0, 1.0, effects, REPETITIONS, generator)
        planners[str(number)] = TrialValues(
            scores.values, scores.worlds, scores.repetitions
        )
    ranking = rank(planners, larger_is_better=True, flips=_FLIPS)
    return any(ranking.is_clear(*pair) for pair in ranking.p)


def _drive_plan(
    worlds: int,
    percent: float,
    generator: np.random.Generator,
    improvement: float = 0.0,
    steady: bool = False,
) -> LookResult:
    """Decide by a plan with looks; of two builds, a steady first one never fails."""
    percents = (0.0 if steady else percent, percent)
    first, second = draw_pair(worlds, 1, percents, 1.0 + improvement, generator)
    return decide(
        first,
        second,
        range(worlds),
        plan_looks(worlds),
        larger_is_better=True,
        flips=_FLIPS,
    )


def _plan_decides(
    worlds: int, percent: float, generator: np.random.Generator, **builds: Any
) -> bool:
    plan = _drive_plan(worlds, percent, generator, **builds)
    return plan.decision in ("better", "worse")


def _plan_share(worlds: int, percent: float, generator: np.random.Generator) -> float:
    plan = _drive_plan(worlds, percent, generator, _DIFFERENCE)
    return plan.worlds / worlds


_PLAN_GROUP = CheckGroup(
    "a plan with looks tells two equal builds apart",
    (0.0, 0.05),
    _PLAN,
    _plan_decides,
    _PLANS,
)
GROUPS = {
    "share": CheckGroup(
        _COVERS.format("share"),
        _COVERAGE,
        "{0} worlds x {1}, share {3:g}, correlation in a world {2:g}",
        _share_covers,
        [
            (*size, *setting)
            for size, *setting in product(((50, 3), (300, 5)), (0.3, 0.7), (0.9, 0.7))
        ],
    ),
    "high share": CheckGroup(
        _COVERS.format("share of at least 0.98"),
        _COVERAGE_AT_LEAST,
        "{0} worlds x {1}, share {3:g}, correlation in a world {2:g}",
        partial(_share_covers, of_failures=True),
        [
            (*size, *setting)
            for size, *setting in product(
                ((50, 3), (300, 5)), (0.3, 0.7), (0.98, 0.99, 0.995)
            )
        ],
    ),
    "better": CheckGroup(
        _COVERS.format("chance that a planner is better in a world"),
        _COVERAGE_AT_LEAST,
        "{0} worlds x {1}, chance {3:g}, correlation in a world {2:g}",
        partial(_share_covers, of_pairs=True),
        [
            (*size, 0.3, truth)
            for size, truth in product(((10, 1), (50, 3)), (0.5, 0.8, 0.95, 0.99))
        ],
    ),
    "mean": CheckGroup(
        _COVERS.format("mean that counts failures"),
        _COVERAGE_AT_LEAST,
        _WITH_FAILURES,
        lambda worlds, repetitions, percent, generator: _covers(
            draw_planner(worlds, repetitions, percent, generator).mean(),
            (1.0 - percent / 100.0) * SCORE,
        ),
        [(*size, percent) for size, percent in product(_SIZES, (0.5, 3.0, 10.0))],
    ),
    "skewed": CheckGroup(
        _COVERS.format("mean of exponential values"),
        _COVERAGE_AT_LEAST,
        "{0} worlds",
        lambda worlds, generator: _covers(
            mean_interval(generator.exponential(1.0, worlds), np.arange(worlds)), 1.0
        ),
        [(10,), (50,)],
    ),
    "filtered": CheckGroup(
        _COVERS.format("mean of successes, failures filtered out,"),
        _COVERAGE_AT_LEAST,
        _WITH_FAILURES,
        _mean_of_successes_covers,
        [(10, 1, 10.0), (50, 3, 10.0), (50, 3, 50.0)],
    ),
    "success": CheckGroup(
        _COVERS.format("difference of success"),
        _COVERAGE_AT_LEAST,
        "{0} worlds x {1}, {2:g} and {3:g} % failures",
        _success_difference_covers,
        [(*size, 3.0, 10.0) for size in _SIZES],
    ),
    "unlike": CheckGroup(
        "two planners of equal mean differ clearly, one steady, one quicker that fails",
        _FALSE_ALARMS,
        _WITH_FAILURES,
        lambda worlds, repetitions, percent, generator: _is_clear(
            draw_pair(worlds, repetitions, (0.0, percent), 1.0, generator)
        ),
        [(*size, percent) for size, percent in product(_SIZES, (2.0, 5.0))],
    ),
    "slow": CheckGroup(
        "two planners of equal mean differ clearly, one steady, one at times slow",
        _FALSE_ALARMS,
        "{0} worlds x {1}, {2:g} % of times {3:g} times as long",
        lambda *setting: _is_clear(draw_slow_pair(*setting)),
        [(50, 1, 2.0, 4.0), (300, 1, 0.5, 5.0), (300, 1, 2.0, 3.0), (300, 3, 1.0, 4.0)],
    ),
    "test": CheckGroup(
        "two equal planners differ by the test of signs alone",
        (0.04, 0.06),
        _ALIKE,
        _test_of_signs_differs,
        _WORLDS,
    ),
    "equal": CheckGroup(
        "two equal planners differ clearly",
        _FALSE_ALARMS,
        _ALIKE,
        lambda worlds, generator: _is_clear(draw_equal_planners(2, worlds, generator)),
        _WORLDS,
    ),
    "board": CheckGroup(
        f"a board of {BOARD_PLANNERS} equal planners has a clear difference",
        _FALSE_ALARMS,
        _ALIKE + ", no failures",
        _board_differs,
        [(50,)],
    ),
    "power": CheckGroup(
        f"a difference of {_IMPROVEMENT} is clear",
        _DETECTIONS,
        "{0} worlds x 1, {1:g} % failures",
        lambda worlds, percent, generator: _is_clear(
            draw_pair(worlds, 1, (percent, percent), 1.0 + _DIFFERENCE, generator)
        ),
        [(50, 0.0), (50, 2.0), (100, 2.0), (100, 5.0), (300, 2.0), (300, 5.0)],
    ),
    "equal builds": _PLAN_GROUP,
    "unlike builds": replace(
        _PLAN_GROUP,
        event="a plan with looks tells unlike builds of equal mean apart",
        target=_FALSE_ALARMS,
        simulate=partial(_plan_decides, steady=True),
    ),
    "builds": replace(
        _PLAN_GROUP,
        event=f"a plan with looks finds a difference of {_IMPROVEMENT}",
        target=_DETECTIONS,
        simulate=partial(_plan_decides, improvement=_DIFFERENCE),
        settings=_PLANS[::2],
    ),
    "plan": replace(
        _PLAN_GROUP,
        event=f"share of a plan's trials that a difference of {_IMPROVEMENT} takes,"
        " on average",
        target=(0.0, 0.7),
        simulate=_plan_share,
    ),
}
