"""Simulated trials with the shape of real ones, and what of them is to come how often.

Worlds differ, trials of a world are alike, and failures count with another time.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from barn_eval.analysis.sequential import LOOKS, decide, plan_looks
from barn_eval.analysis.significance import ALPHA, paired_difference, proportion
from barn_eval.analysis.statistics import TrialValues, difference, mean_interval
from barn_eval.analysis.verdict import rank
from barn_metrics.bootstrap import Interval, Statistic
from barn_worlds.base.arrays import Floats, Integers

_FLIPS = 2000  # patterns of signs: enough for whether p is below 5 %, where reports draw 10 000
BOARD_PLANNERS = 8

# The simulated trials: times as DWA's under the paper's protocol, and scores as the challenge's at 0.5 m/s.
_FAILURES, _CORRELATION, _REPETITIONS = 0.07, 0.67, 3
_TIME_S_PER_M, _OVER_WORLDS, _IN_A_WORLD, _FAILURE_S_PER_M = 2.9, 0.2, 0.1, 10.0
_SCORE, _SCORES_OVER_WORLDS, _SCORES_IN_A_WORLD, _BEST_SCORE = 0.28, 0.04, 0.02, 0.5
_DIFFERENCE = 0.1  # of the mean, that is to be found


@dataclass(frozen=True)
class Group:
    """Checks of one kind: what is counted, how often it should come, and what a setting is called, with its numbers.

    once: one simulation of a setting; whether it came, or for how large a share.
    """

    what: str
    wanted: tuple[float, float]
    setting: str
    once: Callable[..., float]
    settings: Sequence[tuple[float, ...]]


def equal_planners(
    count: int, worlds: int, generator: np.random.Generator
) -> list[TrialValues]:
    """Return the time per metre of planners that are alike: the same chances in each world, own draws.

    The chance of a failure is drawn for each world (beta-binomial trials), and so is the mean time of successes.
    """
    fails = _chances(_FAILURES, _CORRELATION, worlds, generator)
    mean = np.log(_TIME_S_PER_M) + generator.normal(0.0, _OVER_WORLDS, worlds)

    def times(world: Integers) -> Floats:
        found: Floats = np.exp(
            mean[world] + generator.normal(0.0, _IN_A_WORLD, len(world))
        )
        return found

    return [
        _trials(_REPETITIONS, fails, times, generator, _FAILURE_S_PER_M)
        for _ in range(count)
    ]


def scored(
    percent: float,
    scale: float,
    effect: Floats,
    trials: int,
    generator: np.random.Generator,
) -> TrialValues:
    """Return scores of a planner, 0 for failures, whose mean is `_SCORE` times scale times the share of successes.

    effect (m,): of each world on its scores. percent: of failures, 0 for none.
    """
    failing = percent / 100.0
    worlds = len(effect)
    fails = (
        _chances(failing, _CORRELATION, worlds, generator)
        if failing
        else np.zeros(worlds)
    )

    def scores(world: Integers) -> Floats:
        return scale * (_SCORE + effect[world]) + generator.normal(
            0.0, _SCORES_IN_A_WORLD, len(world)
        )

    return _trials(trials, fails, scores, generator, 0.0, _BEST_SCORE)


def _trials(
    trials: int,
    fails: Floats,
    values: Statistic,
    generator: np.random.Generator,
    as_failure: float,
    best: float = 0.0,
) -> TrialValues:
    """Return so many trials in each world, of which a share fails (m,)."""
    world, repetition = (
        np.repeat(np.arange(len(fails)), trials),
        np.tile(np.arange(trials), len(fails)),
    )
    drawn = values(world)
    failed = generator.random(len(world)) < fails[world]
    counted = np.where(failed, as_failure, drawn)
    return TrialValues(
        counted,
        world,
        repetition,
        failed.astype(np.int64),
        np.full(len(world), as_failure),
        best,
    )


def _chances(
    share: float, correlation: float, worlds: int, generator: np.random.Generator
) -> Floats:
    """Return a chance for each world (worlds,) so that trials of a world have that correlation."""
    size = 1.0 / correlation - 1.0
    return generator.beta(share * size, (1.0 - share) * size, worlds)


def _holds(found: Interval, truth: float) -> bool:
    return found.low is not None and not found.excludes(truth)


def _share_covers(
    worlds: int,
    trials: int,
    correlation: float,
    truth: float,
    generator: np.random.Generator,
) -> bool:
    world = np.repeat(np.arange(worlds), trials)
    chances = _chances(truth, correlation, worlds, generator)[world]
    return _holds(
        proportion((generator.random(len(world)) < chances).astype(np.int64), world),
        truth,
    )


def _planner(
    worlds: int, trials: int, percent: float, generator: np.random.Generator
) -> TrialValues:
    return scored(
        percent,
        1.0,
        generator.normal(0.0, _SCORES_OVER_WORLDS, worlds),
        trials,
        generator,
    )


def _two(
    worlds: int,
    trials: int,
    percents: tuple[float, float],
    ratio: float,
    generator: np.random.Generator,
) -> tuple[TrialValues, TrialValues]:
    """Return two planners in the same worlds by their shares of failures and the ratio of their means."""
    effect = generator.normal(0.0, _SCORES_OVER_WORLDS, worlds)
    a, b = (1.0 - percent / 100.0 for percent in percents)
    first = scored(percents[0], 1.0, effect, trials, generator)
    return first, scored(percents[1], ratio * a / b, effect, trials, generator)


def _clear(pair: Sequence[TrialValues]) -> bool:
    return difference(pair[0], pair[1], flips=_FLIPS).p <= ALPHA


def _decided(pair: Sequence[TrialValues], worlds: int) -> tuple[bool, float]:
    """Return whether a plan with looks tells A from B, and the share of the worlds that it took."""
    found = decide(
        pair[0],
        pair[1],
        range(worlds),
        plan_looks(worlds),
        larger_is_better=True,
        flips=_FLIPS,
    )
    return found.decision in ("better", "worse"), found.worlds / worlds


def _successes_cover(
    worlds: int, trials: int, percent: float, generator: np.random.Generator
) -> bool:
    planner = _planner(worlds, trials, percent, generator)
    return _holds(
        mean_interval(
            np.where(planner.failures == 1, np.nan, planner.values), planner.worlds
        ),
        _SCORE,
    )


def _success_covers(
    worlds: int, trials: int, a: float, b: float, generator: np.random.Generator
) -> bool:
    fails = [
        _chances(percent / 100.0, _CORRELATION, worlds, generator) for percent in (a, b)
    ]
    first, second = (
        _trials(trials, one, lambda world: np.ones(len(world)), generator, 0.0, 1.0)
        for one in fails
    )
    return _holds(difference(first, second, flips=_FLIPS).interval, (b - a) / 100.0)


def _test_differs(worlds: int, generator: np.random.Generator) -> bool:
    a, b = equal_planners(2, worlds, generator)
    return paired_difference(a.values - b.values, a.worlds, flips=_FLIPS).p <= ALPHA


def _board_differs(worlds: int, generator: np.random.Generator) -> bool:
    """Of what has no value for failures, where the test alone decides."""
    effect = generator.normal(0.0, _SCORES_OVER_WORLDS, worlds)
    planners = [
        scored(0.0, 1.0, effect, _REPETITIONS, generator) for _ in range(BOARD_PLANNERS)
    ]
    plain = {
        str(number): TrialValues(one.values, one.worlds, one.repetitions)
        for number, one in enumerate(planners)
    }
    found = rank(plain, larger_is_better=True, flips=_FLIPS)
    return any(found.is_clear(*places) for places in found.p)


_SIZES = tuple(product((10, 20, 50, 100, 300), (1, 5)))
_COVERED, _AT_LEAST, _ALARMS, _FOUND = (
    (0.93, 0.97),
    (0.93, 1.0),
    (0.0, 0.06),
    (0.5, 1.0),
)
_COVERS, _FAILING = (
    "the 95 % interval of a {} covers the truth",
    "{0} worlds x {1}, {2:g} % failures",
)
_PLAN = f"{{0}} worlds, {LOOKS} looks, {{1:g}} % failures"
_BETTER = f"{100.0 * _DIFFERENCE:g} %"
_FEW = [(10, 1, 10.0), (50, 3, 10.0), (50, 3, 50.0)]
_ALIKE = f"{{0}} worlds x {_REPETITIONS}"
_PLANS, _WORLDS = [(100, 2.0), (300, 2.0), (300, 5.0)], [(20,), (50,), (300,)]


def _of_plans(
    what: str,
    wanted: tuple[float, float],
    by: float = 0.0,
    part: int = 0,
    *,
    steady: bool = False,
) -> Group:
    """Return what is checked of plans with looks: part 0 is whether they decide, part 1 the share that they take."""

    def once(worlds: int, percent: float, generator: np.random.Generator) -> float:
        percents = (0.0 if steady else percent, percent)
        return _decided(_two(worlds, 1, percents, 1.0 + by, generator), worlds)[part]

    return Group(what, wanted, _PLAN, once, _PLANS)


GROUPS = {
    "share": Group(
        _COVERS.format("share"),
        _COVERED,
        "{0} worlds x {1}, share {3:g}, correlation in a world {2:g}",
        _share_covers,
        [
            (*size, *more)
            for size, *more in product(((50, 3), (300, 5)), (0.3, 0.7), (0.9, 0.7))
        ],
    ),
    "mean": Group(
        _COVERS.format("mean that counts failures"),
        _AT_LEAST,
        _FAILING,
        lambda w, t, p, g: _holds(
            _planner(w, t, p, g).mean(), (1.0 - p / 100.0) * _SCORE
        ),
        [(*size, percent) for size, percent in product(_SIZES, (0.5, 3.0, 10.0))],
    ),
    "skewed": Group(
        _COVERS.format("mean of exponential values"),
        _AT_LEAST,
        "{0} worlds",
        lambda w, g: _holds(mean_interval(g.exponential(1.0, w), np.arange(w)), 1.0),
        [(10,), (50,)],
    ),
    "filtered": Group(
        _COVERS.format("mean of successes, failures filtered out,"),
        _AT_LEAST,
        _FAILING,
        _successes_cover,
        _FEW,
    ),
    "success": Group(
        _COVERS.format("difference of success"),
        _AT_LEAST,
        "{0} worlds x {1}, {2:g} and {3:g} % failures",
        _success_covers,
        [(*size, 3.0, 10.0) for size in _SIZES],
    ),
    "unlike": Group(
        "two planners of equal mean differ clearly, one steady, one quicker that fails",
        _ALARMS,
        _FAILING,
        lambda w, t, p, g: _clear(_two(w, t, (0.0, p), 1.0, g)),
        [(*size, percent) for size, percent in product(_SIZES, (2.0, 5.0))],
    ),
    "test": Group(
        "two equal planners differ by the test of signs alone",
        (0.04, 0.06),
        _ALIKE,
        _test_differs,
        _WORLDS,
    ),
    "equal": Group(
        "two equal planners differ clearly",
        _ALARMS,
        _ALIKE,
        lambda w, g: _clear(equal_planners(2, w, g)),
        _WORLDS,
    ),
    "board": Group(
        f"a board of {BOARD_PLANNERS} equal planners has a clear difference",
        _ALARMS,
        _ALIKE + ", no failures",
        _board_differs,
        [(50,)],
    ),
    "power": Group(
        f"a difference of {_BETTER} is clear",
        _FOUND,
        "{0} worlds x 1, {1:g} % failures",
        lambda w, p, g: _clear(_two(w, 1, (p, p), 1.0 + _DIFFERENCE, g)),
        [(50, 0.0), (50, 2.0), (100, 2.0), (100, 5.0), (300, 2.0), (300, 5.0)],
    ),
    "equal builds": _of_plans(
        "a plan with looks tells two equal builds apart", (0.0, 0.05)
    ),
    "unlike builds": _of_plans(
        "a plan with looks tells unlike builds of equal mean apart",
        _ALARMS,
        steady=True,
    ),
    "builds": replace(
        _of_plans(
            f"a plan with looks finds a difference of {_BETTER}", _FOUND, _DIFFERENCE
        ),
        settings=_PLANS[::2],
    ),
    "plan": _of_plans(
        f"share of a plan's trials that a difference of {_BETTER} takes, on average",
        (0.0, 0.7),
        _DIFFERENCE,
        1,
    ),
}
