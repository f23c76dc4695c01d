"""Say how well the worlds of data sets bring planners into their order.

    python qa/studies/statistics/ranking_power.py out/barn300 out/hard1 \
        --measure challenge --measure success

Each folder holds a run of several planners; FOLDER:PLANNER,PLANNER selects some. With
--json, the output is the ranking.json that `validate_statistics.py` reads.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import click
import numpy as np
from rich.console import Console

from barn_eval.analysis.compare import read_selection, trial_values
from barn_eval.analysis.measures import MEASURES, Measure, ranking_measure
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.statistics import matched_trials
from barn_eval.analysis.text_table import TextTable, join_names
from barn_eval.analysis.verdict import rank_results
from barn_eval.commands.tables import rich_table
from barn_eval.trials.result import RowsByPlanner
from barn_metrics.bootstrap import number
from barn_worlds.base.errors import BarnError, ConfigError, suggest

WORLD_COUNTS = (10, 20, 50, 100, 200, 300)
# Worlds are enough from this share of draws in the right order on.
ENOUGH_SHARE = 0.95
_DRAWS = 2000


@dataclass(frozen=True)
class RankingPower:
    """How well worlds of a data set rank planners by a measure."""

    dataset: str

    measure: str
    """Key of the measure."""

    planners: tuple[str, ...]
    """Best first."""

    differing: tuple[tuple[str, str], ...]
    """Pairs (better, worse) with a significant difference over all worlds."""

    worlds: int
    """Number of worlds that all planners have."""

    shares: Mapping[int, float]
    """By number of worlds, the share of draws with all these pairs in order."""

    enough: int | None
    """Fewest worlds with a share of 95% or more; None where all are too few."""


def ranking_power(
    results: RowsByPlanner, measures: Sequence[str] = (), seed: int = 0
) -> list[RankingPower]:
    """Estimate how well the worlds of results rank their planners.

    Worlds are drawn with replacement, so that they stand for other worlds of the same
    kind. The true order, and which planners differ, are those over all worlds.

    Args:
        results: Results by planner, of at least two.
        measures: Keys of measures. By default the ranking measure of the protocol.
        seed: Seed of the draws.

    Raises:
        ConfigError: There are fewer than two planners, or a measure is unknown.
    """
    if len(results) < 2:
        raise ConfigError(
            f"a ranking needs two planners; there is {', '.join(results)} only"
        )
    for key in measures:
        if key not in MEASURES or not MEASURES[key].better:
            raise ConfigError(f"unknown measure {key!r}{suggest(key, MEASURES)}")
    keys = measures or (ranking_measure(next(iter(results.values()))).key,)
    return [_ranking_power_by(MEASURES[key], results, seed) for key in keys]


def _ranking_power_by(
    measure: Measure, results: RowsByPlanner, seed: int
) -> RankingPower:
    """Estimate how well worlds rank planners by one measure."""
    ranking = rank_results(results, measure)
    differing = [pair for pair in ranking.p if ranking.is_clear(*pair)]
    trials = matched_trials(
        [trial_values(results[name], measure) for name in ranking.names]
    )
    _, world = np.unique(trials[0].worlds, return_inverse=True)
    worlds = ranking.worlds
    sign = 1.0 if measure.better == "larger" else -1.0
    sums = [np.bincount(world, t.values, minlength=worlds) for t in trials]
    gains = sign * np.array(sums)

    rng = np.random.default_rng(seed)
    draws = rng.integers(0, max(worlds, 1), (_DRAWS, worlds))
    is_right = np.ones((_DRAWS, worlds), bool)
    for better, worse in differing:
        leads = (gains[better] - gains[worse])[draws]
        is_right &= np.cumsum(leads, axis=1) > 0.0
    share_by_count = is_right.mean(axis=0)
    too_few = np.flatnonzero(share_by_count < ENOUGH_SHARE)
    enough: int | None = 1
    if len(too_few):
        enough = int(too_few[-1]) + 2
    shares = {}
    if differing:
        counts = [count for count in WORLD_COUNTS if count <= worlds]
        shares = {count: float(share_by_count[count - 1]) for count in counts}
    if not differing or (enough is not None and enough > worlds):
        enough = None

    names = [spelling(name) for name in ranking.names]
    datasets = {row.dataset for rows in results.values() for row in rows}
    return RankingPower(
        dataset=", ".join(sorted(datasets)),
        measure=measure.key,
        planners=tuple(names),
        differing=tuple((names[i], names[j]) for i, j in differing),
        worlds=worlds,
        shares=shares,
        enough=enough,
    )


def ranking_table(powers: Sequence[RankingPower]) -> TextTable:
    """Return a row per data set and measure."""
    counts = [n for n in WORLD_COUNTS if any(n in power.shares for power in powers)]
    rows = []
    for power in powers:
        shares = ["-"] * len(counts)
        for position, count in enumerate(counts):
            if count in power.shares:
                shares[position] = number(100.0 * power.shares[count], 1)
        planners = len(power.planners)
        rows.append(
            (
                power.dataset,
                MEASURES[power.measure].title,
                join_names(power.planners),
                f"{len(power.differing)} of {planners * (planners - 1) // 2}",
                *shares,
                str(power.enough or f"over {power.worlds}"),
            )
        )
    columns = (
        "set",
        "measure",
        "planners, best first",
        "pairs that differ",
        *map(str, counts),
        "95% from",
    )
    title = (
        "Draws of so many worlds in which all planners that differ come in the right "
        "order [%]"
    )
    return TextTable("ranking", title, columns, tuple(rows), texts=3)


@click.command()
@click.argument("folders", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--measure",
    "measures",
    multiple=True,
    help="A column of the results, repeatable [default: the metric of the protocol].",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def main(folders: tuple[Path, ...], measures: tuple[str, ...], as_json: bool) -> None:
    """Say how many worlds bring the planners of FOLDERS into the right order."""
    powers = []
    try:
        for folder in folders:
            _, rows_by_planner = read_selection(folder)
            powers += ranking_power(rows_by_planner, measures)
    except BarnError as error:
        raise click.ClickException(str(error)) from None
    if as_json:
        click.echo(json.dumps([asdict(power) for power in powers], indent=1))
    else:
        Console().print(rich_table(ranking_table(powers)))


if __name__ == "__main__":
    main()
