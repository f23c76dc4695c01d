"""Order worlds from easy to difficult by their trials, and split them into bands."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from barn_eval.analysis.entries import Entry
from barn_eval.analysis.measures import MEASURES, SHOWN, Measure
from barn_eval.analysis.summary import Summary, summarize
from barn_eval.results.row_table import column, take
from barn_eval.trials.result import Rows

TIME = MEASURES["normalised_time_s_per_m"]
_MAX_BANDS = 4
_MIN_WORLDS_PER_BAND = 3


@dataclass(frozen=True)
class WorldOrder:
    """Worlds from easy to difficult."""

    worlds: Sequence[int]
    """Numbers of the worlds."""

    mean_s_per_m: Sequence[float]
    """Counted time per meter, averaged over all trials of a world.

    Each entry has the same weight. This is the paper's measure (Sec. IV-B).
    """

    left_out: int
    """Number of worlds in which some entry has no trial."""


@dataclass(frozen=True)
class Band:
    """Neighboring worlds of an order, and what each entry did in them."""

    name: str
    worlds: Sequence[int]

    limits_s_per_m: tuple[float, float]
    """Counted time per meter of the easiest and the hardest of its worlds."""

    summaries: Sequence[Summary]
    """In the order of entries."""


def means_by_world(results: Rows, measure: Measure) -> dict[int, float]:
    """Return the mean value of a measure by world number, NaN if a value is missing."""
    worlds = column(results, "world")
    values = measure.values(results)
    return {
        world: float(values[worlds == world].mean())
        for world in np.unique(worlds).tolist()
    }


def rows_in_worlds(results: Rows, worlds: Sequence[int]) -> Rows:
    """Return the results in worlds with these numbers, in the order of the results."""
    return take(results, np.isin(column(results, "world"), worlds))


def order_worlds(entries: Sequence[Entry]) -> WorldOrder:
    """Sort worlds that all entries have, or else all, by mean counted time per meter.

    Only worlds in which every entry has a trial count; if there are none, all count.
    """
    means_s_per_m = [means_by_world(entry.results, TIME) for entry in entries]
    all_worlds = set().union(*means_s_per_m)
    # A world that only a slow planner has driven would seem difficult.
    shared_worlds = set.intersection(*map(set, means_s_per_m)) or all_worlds

    order = []
    for world in shared_worlds:
        # A mean of planners: one with more repetitions must not weigh more.
        means = [group[world] for group in means_s_per_m if world in group]
        order.append((float(np.mean(means)), world))
    order.sort()

    return WorldOrder(
        worlds=[world for _, world in order],
        mean_s_per_m=[mean for mean, _ in order],
        left_out=len(all_worlds) - len(shared_worlds),
    )


def make_bands(entries: Sequence[Entry], order: WorldOrder) -> list[Band]:
    """Split ordered worlds into up to four bands with summaries; [] below six worlds.

    Args:
        entries: Planners whose results are summarized.
        order: Their worlds from easy to difficult.

    Returns:
        The bands, easiest first; none if there are too few worlds for two.
    """
    # With fewer than three worlds, no test over worlds can find a difference.
    count = min(_MAX_BANDS, len(order.worlds) // _MIN_WORLDS_PER_BAND)
    if count < 2:
        return []

    middle_names = [f"{number} of {count}" for number in range(2, count)]
    names = ["easiest", *middle_names, "hardest"]
    positions = np.array_split(np.arange(len(order.worlds)), count)
    bands = []
    for name, part in zip(names, positions, strict=True):
        worlds = [order.worlds[position] for position in part]
        summaries = []
        for entry in entries:
            results = rows_in_worlds(entry.results, worlds)
            summaries.append(summarize(results, SHOWN["bands"], entry.label))
        bands.append(
            Band(
                name=name,
                worlds=worlds,
                limits_s_per_m=(
                    order.mean_s_per_m[part[0]],
                    order.mean_s_per_m[part[-1]],
                ),
                summaries=summaries,
            )
        )
    return bands
