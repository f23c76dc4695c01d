"""`barn compare`: two planners, or two campaigns of one planner, on the worlds and seeds that they share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import click
from rich.table import Table

from barn_eval.analysis.campaign_summary import by_planner
from barn_eval.analysis.compare import Comparison, compare
from barn_eval.commands.options import console, json_option, print_json, row, table
from barn_eval.experiments.folder import read_results
from barn_eval.trials.result import TrialResult
from barn_metrics.bootstrap import Interval
from barn_worlds.config import as_dict
from barn_worlds.errors import ConfigError, suggest


@click.command("compare")
@click.argument("a", type=click.Path(path_type=Path))
@click.argument("b", type=click.Path(path_type=Path))
@json_option
def compare_command(a: Path, b: Path, as_json: bool) -> None:
    """Compare A with B: folders of runs or campaigns, finished or not.

    FOLDER:PLANNER chooses one of several planners. Where both folders hold several and none is chosen, planners of
    the same name are compared.
    """
    first, second = _groups(a), _groups(b)
    if len(first) == len(second) == 1:
        pairs = [(*first, *second)]
    else:
        pairs = [(name, name) for name in first if name in second]
    if not pairs:
        raise ConfigError(
            f"{a} has {', '.join(first)} and {b} has {', '.join(second)}: choose planners as FOLDER:PLANNER"
        )
    found = [compare(first[one], second[other], f"A: {one}", f"B: {other}") for one, other in pairs]
    if as_json:
        print_json([as_dict(one) for one in found])
        return
    for one in found:
        console.print(comparison_table(one))


def comparison_table(found: Comparison) -> Table:
    """Return a table of differences with their intervals, a row per measure."""
    made = table(
        "measure",
        f">{found.a}",
        f">{found.b}",
        ">difference and 95 % interval",
        ">P(first is better)",
        ">trials",
        title=f"{found.a} against {found.b}, {found.protocol} protocol, same worlds and seeds",
    )
    for one in found.rows:
        pair = one.paired
        row(
            made,
            f"{one.measure} [{one.unit}]" if one.unit else one.measure,
            number(pair.mean_a),
            number(pair.mean_b),
            estimate(pair.difference),
            estimate(pair.improvement),
            str(pair.trials),
        )
    made.caption = f"rank correlation of time per metre over worlds: {estimate(found.rank_correlation)}"
    made.caption_justify = "left"
    return made


def estimate(interval: Interval) -> str:
    """Return an estimate with its limits."""
    text = number(interval.estimate)
    if interval.low is None or interval.high is None:
        return text
    return f"{text} [{number(interval.low)}, {number(interval.high)}]"


def number(value: float) -> str:
    """Return a number with three decimals below 10, else two; a dash for NaN."""
    if math.isnan(value):
        return "-"
    return f"{value:.3f}" if abs(value) < 10.0 else f"{value:.2f}"


def _groups(source: Path) -> dict[str, Sequence[TrialResult]]:
    """Return the results of a folder by planner, of the chosen one only if one is."""
    chosen = ""
    if not source.exists() and ":" in source.name:
        folder, _, chosen = str(source).rpartition(":")
        source = Path(folder)
    groups = by_planner(read_results(source))
    if chosen and chosen not in groups:
        raise ConfigError(f"{source}: has no planner {chosen!r}{suggest(chosen, groups)}")
    return {chosen: groups[chosen]} if chosen else dict(groups)
