"""Whether intervals and tests keep what they promise: simulated trials, judged by the functions that reports use.

Trials have the shape of real ones: worlds differ, trials of a world are alike, and failures count with another time.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from barn_eval.analysis.means import Columns, mean_interval
from barn_eval.analysis.significance import ALPHA, proportion
from barn_eval.analysis.statistics import difference
from barn_eval.analysis.text_table import TextTable
from barn_eval.analysis.verdict import FEW_WORLDS, rank
from barn_eval.pages.template import render
from barn_metrics.bootstrap import Interval, number
from barn_worlds.base.arrays import Floats, Integers
from barn_worlds.base.text_files import markdown_table

COVERED, AT_LEAST, FALSE_ALARMS = (0.93, 0.97), (0.93, 1.0), (0.0, 0.06)
SHARES = ((50, 3), (300, 5))  # worlds and trials in each
SHARE_CORRELATIONS, SHARE_TRUTHS = (0.3, 0.7), (0.9, 0.7)
MEANS = tuple((worlds, trials) for worlds in (10, 50, 300) for trials in (1, 5))
MEAN_FAILURES = (0.005, 0.03, 0.1)
SKEWED_WORLDS = (10, 50)
SUCCESSES = ((10, 1), (10, 5), (50, 5))
SUCCESS_FAILURES = 0.03, 0.1  # of A and of B
UNLIKE = ((50, 1), (50, 5), (300, 1), (300, 5))
UNLIKE_FAILURES = (0.02, 0.05)  # of the quicker one; the other never fails
PAIR_WORLDS, BOARD_WORLDS, BOARD_PLANNERS, REPETITIONS = (20, 50, 300), 50, 8, 3
SIMULATIONS = 1000
_CHANCE = 3.0  # standard errors

# The simulated trials: times as DWA's under the paper's protocol, and scores as the challenge's at 0.5 m/s.
_FAILURES, _CORRELATION = 0.07, 0.67
_TIME_S_PER_M, _OVER_WORLDS, _IN_A_WORLD, _FAILURE_S_PER_M = 2.9, 0.2, 0.1, 10.0
_SCORE, _SCORES_OVER_WORLDS, _SCORES_IN_A_WORLD, _BEST_SCORE = 0.28, 0.04, 0.02, 0.5


@dataclass(frozen=True)
class Check:
    """How often something came in simulations, and how often it should. what: is counted; setting: of the trials."""

    what: str
    setting: str
    simulations: int
    found: float
    wanted: tuple[float, float]

    @property
    def standard_error(self) -> float:
        """The Monte Carlo standard error of what was found."""
        return math.sqrt(self.found * (1.0 - self.found) / self.simulations)

    @property
    def verdict(self) -> str:
        """Whether it is as wanted: "met", "met within chance" or "missed"."""
        low, high = self.wanted
        if low <= self.found <= high:
            return "met"
        # The error of a share at the limit, as that of one that is found to be 0 is 0.
        limit = low if self.found < low else high
        error = math.sqrt(limit * (1.0 - limit) / self.simulations)
        return "met within chance" if abs(self.found - limit) <= _CHANCE * error else "missed"


def checks(simulations: int = SIMULATIONS, seed: int = 0) -> Iterator[Check]:
    """Yield the outcome of each check; each has random numbers of its own, which follow from the seed."""
    seeds = iter(np.random.SeedSequence(seed).spawn(100))
    for what, wanted, text, once, settings in _groups():
        for setting in settings:
            generator = np.random.default_rng(next(seeds))
            found = sum(once(*setting, generator) for _ in range(simulations)) / simulations
            yield Check(what, text.format(*setting, percent=100.0 * setting[-1]), simulations, found, wanted)


_Group = tuple[str, tuple[float, float], str, Callable[..., bool], Sequence[tuple[float, ...]]]


def _groups() -> Iterator[_Group]:
    """Yield what is counted, how often it should come, the text of a setting, one simulation of it, and settings."""
    covers, failing = "the 95 % interval of a {} covers the truth", "{} worlds x {}, {percent:g} % failures"
    unlike = "two planners of equal mean differ clearly, one steady, one quicker that fails"
    board = f"a board of {BOARD_PLANNERS} equal planners has a clear difference"
    a, b = (100.0 * one for one in SUCCESS_FAILURES)

    shares = "{0} worlds x {1}, share {3:g}, correlation in a world {2:g}"
    settings = [(*sizes, *more) for sizes, *more in product(SHARES, SHARE_CORRELATIONS, SHARE_TRUTHS)]
    yield covers.format("share"), COVERED, shares, _share_covers, settings
    settings = [(*sizes, share) for sizes, share in product(MEANS, MEAN_FAILURES)]
    yield covers.format("mean that counts failures"), AT_LEAST, failing, _mean_covers, settings
    settings = [(worlds,) for worlds in SKEWED_WORLDS]
    yield covers.format("mean of exponential values"), AT_LEAST, "{} worlds", _skewed_covers, settings
    both = f"{{}} worlds x {{}}, {a:g} and {b:g} % failures"
    yield covers.format("difference of success"), AT_LEAST, both, _success_covers, SUCCESSES
    settings = [(*sizes, share) for sizes, share in product(UNLIKE, UNLIKE_FAILURES)]
    yield unlike, FALSE_ALARMS, failing, _unlike_differ, settings
    equal = f"{{}} worlds x {REPETITIONS}"
    settings = [(worlds,) for worlds in PAIR_WORLDS]
    yield "two equal planners differ clearly", FALSE_ALARMS, equal, _pair_differs, settings
    yield board, FALSE_ALARMS, equal, _board_differs, [(BOARD_WORLDS,)]


def checks_table(found: Sequence[Check]) -> TextTable:
    """Return what was found beside what was wanted, in percent."""
    columns = ("in simulations", "of", "found [%]", "error [%]", "wanted [%]", "")
    rows = [
        (
            one.what,
            one.setting,
            number(100.0 * one.found, 1),
            number(100.0 * one.standard_error, 1),
            f"{100.0 * one.wanted[0]:g} to {100.0 * one.wanted[1]:g}",
            one.verdict,
        )
        for one in found
    ]
    return TextTable("validation", f"{found[0].simulations} simulations each", columns, tuple(rows), texts=2)


def statistics_page(found: Sequence[Check], seed: int) -> str:
    """Return docs/statistics.md, with the table of what was found."""
    made = checks_table(found)
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

    return [_trials(REPETITIONS, fails, times, generator, _FAILURE_S_PER_M) for _ in range(count)]


def scored(failing: float, scale: float, effect: Floats, trials: int, generator: np.random.Generator) -> Columns:
    """Return scores of a planner, 0 for failures, whose mean is `_SCORE` times scale times the share of successes.

    effect (m,): of each world on its scores. failing: share of failures, 0 for none.
    """
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


def _mean_covers(worlds: int, trials: int, failing: float, generator: np.random.Generator) -> bool:
    effect = generator.normal(0.0, _SCORES_OVER_WORLDS, worlds)
    return _holds(scored(failing, 1.0, effect, trials, generator).mean(), (1.0 - failing) * _SCORE)


def _skewed_covers(worlds: int, generator: np.random.Generator) -> bool:
    return _holds(mean_interval(generator.exponential(1.0, worlds), np.arange(worlds)), 1.0)


def _success_covers(worlds: int, trials: int, generator: np.random.Generator) -> bool:
    fails = [_chances(failing, _CORRELATION, worlds, generator) for failing in SUCCESS_FAILURES]
    a, b = (_trials(trials, one, lambda world: np.ones(len(world)), generator, 0.0, 1.0) for one in fails)
    return _holds(difference(a, b).interval, SUCCESS_FAILURES[1] - SUCCESS_FAILURES[0])


def _unlike_differ(worlds: int, trials: int, failing: float, generator: np.random.Generator) -> bool:
    effect = generator.normal(0.0, _SCORES_OVER_WORLDS, worlds)
    steady = scored(0.0, 1.0, effect, trials, generator)
    quicker = scored(failing, 1.0 / (1.0 - failing), effect, trials, generator)
    return difference(steady, quicker).p <= ALPHA


def _pair_differs(worlds: int, generator: np.random.Generator) -> bool:
    a, b = equal_planners(2, worlds, generator)
    return difference(a, b).p <= ALPHA


def _board_differs(worlds: int, generator: np.random.Generator) -> bool:
    planners = equal_planners(BOARD_PLANNERS, worlds, generator)
    found = rank({str(number): one for number, one in enumerate(planners)}, larger_is_better=False)
    return any(found.clear(*places) for places in found.p)
