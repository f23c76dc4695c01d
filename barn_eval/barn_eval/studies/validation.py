"""Whether intervals and tests keep what they promise: simulated trials, judged by the functions that reports use.

Trials have the shape of real ones: worlds differ, trials of a world are alike, and failures count with another time.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from barn_eval.analysis.means import Columns, mean_interval
from barn_eval.analysis.sequential import decide
from barn_eval.analysis.significance import ALPHA, paired_difference, proportion
from barn_eval.analysis.statistics import difference
from barn_eval.analysis.text_table import TextTable
from barn_eval.analysis.verdict import FEW_WORLDS, rank
from barn_eval.pages.template import render
from barn_metrics.bootstrap import Interval, number
from barn_worlds.base.arrays import Floats, Integers
from barn_worlds.base.text_files import markdown_table

SIMULATIONS, SEEDS = 400, 2
_FLIPS = 2000  # patterns of signs: enough for whether p is below 5 %, where reports draw 10 000
BOARD_PLANNERS, LOOKS = 8, 5
_CHANCE = 3.0  # standard errors

# The simulated trials: times as DWA's under the paper's protocol, and scores as the challenge's at 0.5 m/s.
_FAILURES, _CORRELATION, _REPETITIONS = 0.07, 0.67, 3
_TIME_S_PER_M, _OVER_WORLDS, _IN_A_WORLD, _FAILURE_S_PER_M = 2.9, 0.2, 0.1, 10.0
_SCORE, _SCORES_OVER_WORLDS, _SCORES_IN_A_WORLD, _BEST_SCORE = 0.28, 0.04, 0.02, 0.5
_DIFFERENCE = 0.1  # of the mean, that is to be found


@dataclass(frozen=True)
class Check:
    """How often something came in simulations, and how often it should. what: is counted; setting: of the trials.

    found: shares, one for each seed.
    """

    what: str
    setting: str
    simulations: int
    found: tuple[float, ...]
    wanted: tuple[float, float]

    @property
    def standard_error(self) -> float:
        """The Monte Carlo standard error of what was found with one seed."""
        return max(math.sqrt(one * (1.0 - one) / self.simulations) for one in self.found)

    @property
    def verdict(self) -> str:
        """Whether it is as wanted, with all seeds: "met", "met within chance" or "missed"."""
        low, high = self.wanted
        worst = max(self.found, key=lambda one: max(low - one, one - high))
        if low <= worst <= high:
            return "met"
        # The error of a share at the limit, as that of one that is found to be 0 is 0.
        limit = low if worst < low else high
        error = math.sqrt(limit * (1.0 - limit) / self.simulations)
        return "met within chance" if abs(worst - limit) <= _CHANCE * error else "missed"


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


def checks(simulations: int = SIMULATIONS, seed: int = 0, groups: Sequence[Group] | None = None) -> Iterator[Check]:
    """Yield the outcome of each check, by `SEEDS` seeds from this one on; each check has random numbers of its own."""
    for group in GROUPS.values() if groups is None else groups:
        for setting in group.settings:
            found = []
            for own in range(seed, seed + SEEDS):
                generator = np.random.default_rng([own, *group.what.encode(), *map(round, (1000 * x for x in setting))])
                found.append(sum(group.once(*setting, generator) for _ in range(simulations)) / simulations)
            yield Check(group.what, group.setting.format(*setting), simulations, tuple(found), group.wanted)


def checks_table(found: Sequence[Check], seed: int) -> TextTable:
    """Return what was found beside what was wanted, in percent."""
    by_seed = [f"seed {own} [%]" for own in range(seed, seed + len(found[0].found))]
    columns = ("in simulations", "of", *by_seed, "error [%]", "wanted [%]", "")
    rows = [
        (
            one.what,
            one.setting,
            *(number(100.0 * share, 1) for share in one.found),
            number(100.0 * one.standard_error, 1),
            f"{100.0 * one.wanted[0]:g} to {100.0 * one.wanted[1]:g}",
            one.verdict,
        )
        for one in found
    ]
    return TextTable("validation", f"{found[0].simulations} simulations each", columns, tuple(rows), texts=2)


def statistics_page(found: Sequence[Check], seed: int) -> str:
    """Return docs/statistics.md, with the table of what was found."""
    made = checks_table(found, seed)
    return render(
        "statistics.md",
        few_worlds=FEW_WORLDS,
        simulations=found[0].simulations,
        seed=seed,
        table=markdown_table(made.columns, made.rows),
    )


def equal_planners(count: int, worlds: int, generator: np.random.Generator) -> list[Columns]:
    """Return the time per metre of planners that are alike: the same chances in each world, own draws.

    The chance of a failure is drawn for each world (beta-binomial trials), and so is the mean time of successes.
    """
    fails = _chances(_FAILURES, _CORRELATION, worlds, generator)
    mean = np.log(_TIME_S_PER_M) + generator.normal(0.0, _OVER_WORLDS, worlds)

    def times(world: Integers) -> Floats:
        found: Floats = np.exp(mean[world] + generator.normal(0.0, _IN_A_WORLD, len(world)))
        return found

    return [_trials(_REPETITIONS, fails, times, generator, _FAILURE_S_PER_M) for _ in range(count)]


def scored(percent: float, scale: float, effect: Floats, trials: int, generator: np.random.Generator) -> Columns:
    """Return scores of a planner, 0 for failures, whose mean is `_SCORE` times scale times the share of successes.

    effect (m,): of each world on its scores. percent: of failures, 0 for none.
    """
    failing = percent / 100.0
    worlds = len(effect)
    fails = _chances(failing, _CORRELATION, worlds, generator) if failing else np.zeros(worlds)

    def scores(world: Integers) -> Floats:
        return scale * (_SCORE + effect[world]) + generator.normal(0.0, _SCORES_IN_A_WORLD, len(world))

    return _trials(trials, fails, scores, generator, 0.0, _BEST_SCORE)


def _trials(
    trials: int,
    fails: Floats,
    values: Callable[[Integers], Floats],
    generator: np.random.Generator,
    as_failure: float,
    best: float = 0.0,
) -> Columns:
    """Return so many trials in each world, of which a share fails (m,)."""
    world, repetition = np.repeat(np.arange(len(fails)), trials), np.tile(np.arange(trials), len(fails))
    drawn = values(world)
    failed = generator.random(len(world)) < fails[world]
    counted = np.where(failed, as_failure, drawn)
    return Columns(counted, world, repetition, failed.astype(np.int64), np.full(len(world), as_failure), best)


def _chances(share: float, correlation: float, worlds: int, generator: np.random.Generator) -> Floats:
    """Return a chance for each world (worlds,) so that trials of a world have that correlation."""
    size = 1.0 / correlation - 1.0
    return generator.beta(share * size, (1.0 - share) * size, worlds)


def _holds(found: Interval, truth: float) -> bool:
    return found.low is not None and not found.excludes(truth)


def _share_covers(worlds: int, trials: int, correlation: float, truth: float, generator: np.random.Generator) -> bool:
    world = np.repeat(np.arange(worlds), trials)
    chances = _chances(truth, correlation, worlds, generator)[world]
    return _holds(proportion((generator.random(len(world)) < chances).astype(np.int64), world), truth)


def _effect(worlds: int, generator: np.random.Generator) -> Floats:
    found: Floats = generator.normal(0.0, _SCORES_OVER_WORLDS, worlds)
    return found


def _mean_covers(worlds: int, trials: int, percent: float, generator: np.random.Generator) -> bool:
    planner = scored(percent, 1.0, _effect(worlds, generator), trials, generator)
    return _holds(planner.mean(), (1.0 - percent / 100.0) * _SCORE)


def _successes_cover(worlds: int, trials: int, percent: float, generator: np.random.Generator) -> bool:
    planner = scored(percent, 1.0, _effect(worlds, generator), trials, generator)
    return _holds(mean_interval(np.where(planner.failures == 1, np.nan, planner.values), planner.worlds), _SCORE)


def _skewed_covers(worlds: int, generator: np.random.Generator) -> bool:
    return _holds(mean_interval(generator.exponential(1.0, worlds), np.arange(worlds)), 1.0)


def _success_covers(worlds: int, trials: int, a: float, b: float, generator: np.random.Generator) -> bool:
    fails = [_chances(percent / 100.0, _CORRELATION, worlds, generator) for percent in (a, b)]
    first, second = (_trials(trials, one, lambda world: np.ones(len(world)), generator, 0.0, 1.0) for one in fails)
    return _holds(difference(first, second, flips=_FLIPS).interval, (b - a) / 100.0)


def _unlike(worlds: int, trials: int, percent: float, generator: np.random.Generator) -> tuple[Columns, Columns]:
    """Return a steady planner, and a quicker one of the same mean that fails."""
    effect, scale = _effect(worlds, generator), 1.0 / (1.0 - percent / 100.0)
    return scored(0.0, 1.0, effect, trials, generator), scored(percent, scale, effect, trials, generator)


def _clear(a: Columns, b: Columns) -> bool:
    return difference(a, b, flips=_FLIPS).p <= ALPHA


def _unlike_differ(worlds: int, trials: int, percent: float, generator: np.random.Generator) -> bool:
    return _clear(*_unlike(worlds, trials, percent, generator))


def _test_differs(worlds: int, generator: np.random.Generator) -> bool:
    a, b = equal_planners(2, worlds, generator)
    return paired_difference(a.values - b.values, a.worlds, flips=_FLIPS).p <= ALPHA


def _pair_differs(worlds: int, generator: np.random.Generator) -> bool:
    a, b = equal_planners(2, worlds, generator)
    return _clear(a, b)


def _board_differs(worlds: int, generator: np.random.Generator) -> bool:
    """Of what has no value for failures, where the test alone decides."""
    effect = _effect(worlds, generator)
    planners = [scored(0.0, 1.0, effect, _REPETITIONS, generator) for _ in range(BOARD_PLANNERS)]
    plain = {str(number): Columns(one.values, one.worlds, one.repetitions) for number, one in enumerate(planners)}
    found = rank(plain, larger_is_better=True, flips=_FLIPS)
    return any(found.clear(*places) for places in found.p)


def _builds(worlds: int, percent: float, better: float, generator: np.random.Generator) -> tuple[Columns, Columns]:
    effect = _effect(worlds, generator)
    first, second = (scored(percent, scale, effect, 1, generator) for scale in (1.0, 1.0 + better))
    return first, second


def _difference_found(worlds: int, percent: float, generator: np.random.Generator) -> bool:
    return _clear(*_builds(worlds, percent, _DIFFERENCE, generator))


def _decided(a: Columns, b: Columns, worlds: int) -> tuple[bool, float]:
    """Return whether a plan with looks tells A from B, and the share of the worlds that it took."""
    looks = [worlds * look // LOOKS for look in range(1, LOOKS + 1)]
    found = decide(a, b, range(worlds), looks, larger_is_better=True, flips=_FLIPS)
    return found.decided in ("better", "worse"), found.worlds / worlds


def _equal_builds_differ(worlds: int, percent: float, generator: np.random.Generator) -> bool:
    return _decided(*_builds(worlds, percent, 0.0, generator), worlds)[0]


def _unlike_builds_differ(worlds: int, percent: float, generator: np.random.Generator) -> bool:
    return _decided(*_unlike(worlds, 1, percent, generator), worlds)[0]


def _builds_differ(worlds: int, percent: float, generator: np.random.Generator) -> bool:
    return _decided(*_builds(worlds, percent, _DIFFERENCE, generator), worlds)[0]


def _share_of_plan(worlds: int, percent: float, generator: np.random.Generator) -> float:
    return _decided(*_builds(worlds, percent, _DIFFERENCE, generator), worlds)[1]


_SIZES = tuple(product((10, 20, 50, 100, 300), (1, 5)))
_COVERED, _AT_LEAST, _ALARMS, _FOUND = (0.93, 0.97), (0.93, 1.0), (0.0, 0.06), (0.5, 1.0)
_COVERS, _FAILING = "the 95 % interval of a {} covers the truth", "{0} worlds x {1}, {2:g} % failures"
_PLAN = f"{{0}} worlds, {LOOKS} looks, {{1:g}} % failures"
_BETTER = f"{100.0 * _DIFFERENCE:g} %"


def _sizes(*percents: float) -> list[tuple[float, ...]]:
    return [(*size, percent) for size, percent in product(_SIZES, percents)]


GROUPS = {
    "share": Group(
        _COVERS.format("share"),
        _COVERED,
        "{0} worlds x {1}, share {3:g}, correlation in a world {2:g}",
        _share_covers,
        [(*size, *more) for size, *more in product(((50, 3), (300, 5)), (0.3, 0.7), (0.9, 0.7))],
    ),
    "mean": Group(
        _COVERS.format("mean that counts failures"), _AT_LEAST, _FAILING, _mean_covers, _sizes(0.5, 3.0, 10.0)
    ),
    "skewed": Group(
        _COVERS.format("mean of exponential values"), _AT_LEAST, "{0} worlds", _skewed_covers, [(10,), (50,)]
    ),
    "filtered": Group(
        _COVERS.format("mean of successes, failures filtered out,"),
        _AT_LEAST,
        _FAILING,
        _successes_cover,
        [(10, 1, 10.0), (50, 3, 10.0), (50, 3, 50.0)],
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
        _unlike_differ,
        _sizes(2.0, 5.0),
    ),
    "test": Group(
        "two equal planners differ by the test of signs alone",
        (0.04, 0.06),
        f"{{0}} worlds x {_REPETITIONS}",
        _test_differs,
        [(20,), (50,), (300,)],
    ),
    "equal": Group(
        "two equal planners differ clearly",
        _ALARMS,
        f"{{0}} worlds x {_REPETITIONS}",
        _pair_differs,
        [(20,), (50,), (300,)],
    ),
    "board": Group(
        f"a board of {BOARD_PLANNERS} equal planners has a clear difference",
        _ALARMS,
        f"{{0}} worlds x {_REPETITIONS}, no failures",
        _board_differs,
        [(50,)],
    ),
    "power": Group(
        f"a difference of {_BETTER} is clear",
        _FOUND,
        "{0} worlds x 1, {1:g} % failures",
        _difference_found,
        [(50, 0.0), (50, 2.0), (100, 2.0), (100, 5.0), (300, 2.0), (300, 5.0)],
    ),
    "equal builds": Group(
        "a plan with looks tells two equal builds apart",
        (0.0, 0.05),
        _PLAN,
        _equal_builds_differ,
        [(100, 2.0), (300, 2.0), (300, 5.0)],
    ),
    "unlike builds": Group(
        "a plan with looks tells unlike builds of equal mean apart",
        _ALARMS,
        _PLAN,
        _unlike_builds_differ,
        [(100, 2.0), (300, 2.0), (300, 5.0)],
    ),
    "builds": Group(
        f"a plan with looks finds a difference of {_BETTER}", _FOUND, _PLAN, _builds_differ, [(100, 2.0), (300, 5.0)]
    ),
    "plan": Group(
        f"share of a plan's trials that a difference of {_BETTER} takes, on average",
        (0.0, 0.7),
        _PLAN,
        _share_of_plan,
        [(100, 2.0), (300, 2.0), (300, 5.0)],
    ),
}
