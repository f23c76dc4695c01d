"""The figures of a report: what each shows, and which of them need not wait for intervals."""

from collections.abc import Iterator, Mapping, Sequence

from barn_eval.analysis.difficulty import LEARNED_UNDER, Difficulty, predicted
from barn_eval.analysis.overview import Analysis, Overview
from barn_eval.analysis.sources import Entry
from barn_eval.pages.figures import Picture
from barn_eval.pages.report import charts as figures
from barn_eval.pages.report.maps import DrivenTrial, hardest_figure
from barn_worlds.worlds.world import World

MOST_PICTURES = 8


def all_pictures(
    entries: Sequence[Entry],
    analysis: Analysis,
    drives: Sequence[DrivenTrial],
    worlds: Mapping[str, World],
    hardest: int,
) -> Iterator[Picture]:
    """Yield the pictures of a report that there is something for, those that take longest to draw first.

    worlds: by checksum. hardest: how many worlds are drawn.
    """
    order = analysis.order
    groups: dict[int, list[DrivenTrial]] = {}
    for drive in drives:
        groups.setdefault(drive.result.world, []).append(drive)
    at_hand = _at_hand(groups, worlds)
    drawn = {number: at_hand[number] for number in reversed(order.worlds) if number in at_hand}
    drawn = dict(list(drawn.items())[:hardest])
    if drawn:
        yield Picture(
            "hardest",
            hardest_figure(entries, order, drawn, groups),
            "The hardest worlds with all trajectories that were recorded",
        )
    yield Picture(
        "distributions",
        figures.distributions_figure(entries),
        "Cumulative distributions over trials of time per metre, clearance, speed and jerk",
    )
    yield Picture(
        "worlds",
        figures.worlds_figure(entries, order, _predicted(entries, order, at_hand)),
        "Time per metre as counted of each planner in each world, worlds from easy to difficult",
    )
    compute = figures.compute_figure(entries)
    if compute is not None:
        yield Picture(
            "compute",
            compute,
            "Planner's computing time per cycle over trials: box from quartile to quartile, whiskers 5 to 95 %",
        )
    yield Picture("outcomes", figures.strip_figure(entries, order), "Outcome of every trial in every world")
    yield from _of_intervals(entries, analysis.overview)


def _of_intervals(entries: Sequence[Entry], found: Overview) -> Iterator[Picture]:
    yield Picture(
        "trade",
        figures.trade_figure(entries, found.summaries),
        "Speed against safety: mean time per metre as counted over smallest clearance, and over time in contact"
        " where there was any, with 95 % intervals of both",
    )
    if found.bands:
        yield Picture(
            "bands",
            figures.bands_figure(entries, found.bands),
            "Metric, success and time per metre by band of difficulty, with 95 % intervals",
        )
    if found.comparisons:
        yield Picture(
            "paired",
            figures.paired_figure(found.comparisons),
            "Paired differences between planners with 95 % intervals; filled where the difference is clear",
        )


def _at_hand(groups: Mapping[int, Sequence[DrivenTrial]], worlds: Mapping[str, World]) -> dict[int, World]:
    """Return worlds by number, without those of which trials disagree or that are not there."""
    known = {number: {drive.result.world_checksum for drive in drives} for number, drives in groups.items()}
    sole = {number: min(checksums) for number, checksums in known.items() if len(checksums) == 1}
    return {number: worlds[checksum] for number, checksum in sole.items() if checksum in worlds}


def _predicted(entries: Sequence[Entry], order: Difficulty, worlds: Mapping[int, World]) -> tuple[float, ...]:
    """Return the predicted difficulty of each world; nothing under protocols that the model knows nothing of."""
    if entries[0].results[0].protocol != LEARNED_UNDER or order.predicted_s_per_m:
        return ()
    return predicted(order, worlds)
