"""The settings of a sweep in order: best first, ties as ties, with the metric over the parameters."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from barn_eval.analysis.leaderboard import Board, Place, board
from barn_eval.analysis.measures import MEASURES, metric_of
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.sources import Entry, read_entries
from barn_eval.analysis.text_table import TextTable
from barn_eval.experiments.sweep import LATENCY, values_of

_BESIDE = ("success", "normalised_time_s_per_m")


def parameters_of(entries: Sequence[Entry]) -> list[str]:
    """Return the parameters by which all entries are settings of one sweep, none if they are not."""
    found = [values_of(entry.source.path) for entry in entries]
    same = len({entry.planner for entry in entries}) == 1 and all(one.keys() == found[0].keys() for one in found)
    return list(found[0]) if same and len(found) > 1 else []


def sweep_board(folder: Path) -> Board:
    """Return the settings of a sweep as one board, whatever their speed caps; BarnError as `read_entries`."""
    entries = read_entries([folder])
    return board(entries, metric_of(entries[0].results))


def sweep_rows(found: Board) -> list[dict[str, Any]]:
    """Return a row per setting: rank, whether it is as good as the best for all that is known, parameters, figures."""
    leaders = found.ranking.leaders
    return [
        {"rank": one.rank, "level_with_best": place in leaders}
        | ({"planner": one.entry.planner} if _several(found) else {})
        | values_of(one.entry.source.path)
        | one.summary.columns()
        | {"folder": str(one.entry.source.path)}
        for place, one in _in_order(found)
    ]


def sweep_table(found: Board) -> TextTable:
    """Return the settings as a table, best first."""
    names, several = list(values_of(found.places[0].entry.source.path)), _several(found)
    measures = [found.measure, *(MEASURES[key] for key in _BESIDE if key != found.measure.key)]
    rows = []
    for place, one in _in_order(found):
        values = values_of(one.entry.source.path).values()
        texts = (f"{value:g}" if isinstance(value, float) else str(value) for value in values)
        level = "best" if place == 0 else "level" if place in found.ranking.leaders else "worse"
        figures = (measure.text(one.summary[measure.key]) for measure in measures)
        planner = (spelling(one.entry.planner),) if several else ()
        rows.append((f"{'=' * one.tied}{one.rank}", *planner, *texts, level, *figures))
    columns = (
        "rank",
        *(("planner",) if several else ()),
        *names,
        "against the best",
        *(measure.heading for measure in measures),
    )
    about = (
        f"By {found.measure.title}, with 95 % intervals; all pairs of settings tested, corrected after Holm. Level: not"
        " clearly worse than the best."
    )
    return TextTable("sweep", found.title, columns, tuple(rows), 2 + len(names) + several, about)


def _several(found: Board) -> bool:
    return len({one.entry.planner for one in found.places}) > 1


def _in_order(found: Board) -> list[tuple[int, Place]]:
    """Return places with their numbers, best first, or planner by planner over the delay."""
    places = list(enumerate(found.places))
    if list(values_of(found.places[0].entry.source.path)) != [LATENCY]:
        return places
    return sorted(places, key=lambda one: (one[1].entry.planner, values_of(one[1].entry.source.path)[LATENCY]))
