"""Whether intervals and tests keep what they promise: simulated trials, judged by the functions that reports use.

Trials have the shape of real ones: worlds differ, trials of a world are alike, and failures count with another time.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from barn_eval.analysis.ranking import rank
from barn_eval.analysis.significance import ALPHA, share
from barn_eval.analysis.statistics import Columns, paired
from barn_eval.analysis.text_table import TextTable
from barn_eval.analysis.verdict import FEW_WORLDS
from barn_eval.pages.template import render
from barn_metrics.bootstrap import number
from barn_worlds.base.arrays import Floats
from barn_worlds.base.text_files import markdown_table

COVERED, FALSE_ALARMS, INVENTED = (0.93, 0.97), (0.03, 0.06), (0.0, 0.06)
SHARES = ((50, 3), (300, 5))  # worlds and trials in each
SHARE_CORRELATIONS, SHARE_TRUTHS = (0.3, 0.7), (0.9, 0.7)
PAIR_WORLDS, BOARD_WORLDS, BOARD_PLANNERS, REPETITIONS = (20, 50, 300), 50, 8, 3
SIMULATIONS = 1000
_CHANCE = 3.0  # standard errors

# The simulated trials: as DWA's under the paper's protocol.
_FAILURES, _CORRELATION = 0.07, 0.67
_TIME_S_PER_M, _OVER_WORLDS, _IN_A_WORLD, _FAILURE_S_PER_M = 2.9, 0.2, 0.1, 10.0


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

    def counted(what: str, setting: str, wanted: tuple[float, float], once: Callable[..., bool]) -> Check:
        generator = np.random.default_rng(next(seeds))
        return Check(what, setting, simulations, sum(once(generator) for _ in range(simulations)) / simulations, wanted)

    for worlds, trials in SHARES:
        for correlation in SHARE_CORRELATIONS:
            for truth in SHARE_TRUTHS:
                yield counted(
                    "the 95 % interval of a share covers the truth",
                    f"{worlds} worlds x {trials}, share {truth:g}, correlation in a world {correlation:g}",
                    COVERED,
                    _share_covers(worlds, trials, correlation, truth),
                )
    for worlds in PAIR_WORLDS:
        yield counted(
            "two equal planners differ clearly", f"{worlds} worlds x {REPETITIONS}", FALSE_ALARMS, _pair_differs(worlds)
        )
    yield counted(
        f"a board of {BOARD_PLANNERS} equal planners has a clear difference",
        f"{BOARD_WORLDS} worlds x {REPETITIONS}",
        INVENTED,
        _board_differs,
    )


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
    world = np.repeat(np.arange(worlds), REPETITIONS)
    repetition = np.tile(np.arange(REPETITIONS), worlds)
    fails = _chances(_FAILURES, _CORRELATION, worlds, generator)[world]
    mean = np.log(_TIME_S_PER_M) + generator.normal(0.0, _OVER_WORLDS, worlds)[world]
    return [Columns(_times(fails, mean, generator), world, repetition) for _ in range(count)]


def _times(fails: Floats, mean: Floats, generator: np.random.Generator) -> Floats:
    times = np.exp(mean + generator.normal(0.0, _IN_A_WORLD, len(mean)))
    return np.where(generator.random(len(mean)) < fails, _FAILURE_S_PER_M, times)


def _chances(share: float, correlation: float, worlds: int, generator: np.random.Generator) -> Floats:
    """Return a chance for each world (worlds,) so that trials of a world have that correlation."""
    size = 1.0 / correlation - 1.0
    return generator.beta(share * size, (1.0 - share) * size, worlds)


def _share_covers(worlds: int, trials: int, correlation: float, truth: float) -> Callable[[np.random.Generator], bool]:
    world = np.repeat(np.arange(worlds), trials)

    def once(generator: np.random.Generator) -> bool:
        chances = _chances(truth, correlation, worlds, generator)[world]
        found = share((generator.random(len(world)) < chances).astype(np.int64), world)
        return found.low is not None and found.high is not None and found.low <= truth <= found.high

    return once


def _pair_differs(worlds: int) -> Callable[[np.random.Generator], bool]:
    def once(generator: np.random.Generator) -> bool:
        a, b = equal_planners(2, worlds, generator)
        return paired(a, b, larger_is_better=False).p <= ALPHA

    return once


def _board_differs(generator: np.random.Generator) -> bool:
    planners = equal_planners(BOARD_PLANNERS, BOARD_WORLDS, generator)
    found = rank({str(number): one for number, one in enumerate(planners)}, larger_is_better=False)
    return any(found.clear(*places) for places in found.p)
