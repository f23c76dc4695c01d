"""Compare observed trials with simulated ones in the same worlds."""

from collections.abc import Iterable, Sequence

import numpy as np

from barn_eval.analysis.entries import Entry
from barn_eval.analysis.planners import spelling
from barn_eval.analysis.statistics import mean_interval
from barn_eval.analysis.text_table import TextTable
from barn_eval.trials.result import TrialResult
from barn_worlds.base.errors import ConfigError

_COLUMNS = (
    "planner",
    "world",
    "measured [s]",
    "successes",
    "simulated [s]",
    "successes",
    "measured - simulated [s]",
)

# Rows by planner and checksum of their world.
_Groups = dict[tuple[str, str], list[TrialResult]]


def pair_by_world(measured: Sequence[Entry], simulated: Sequence[Entry]) -> TextTable:
    """Return a table of times per planner and shared world, and means; ConfigError if none.

    The last row of each planner has the mean difference over its worlds, with its 95%
    interval. Worlds with equal obstacles are the same.

    Args:
        measured: Planners in a system that the suite observed.
        simulated: Planners in the suite's own simulator.

    Raises:
        ConfigError: If protocols differ, or no planner has a world in common.
    """
    measured_groups = _group(measured)
    simulated_groups = _group(simulated)
    protocols = {
        row.protocol for item in (*measured, *simulated) for row in item.results
    }
    if len(protocols) > 1:
        raise ConfigError(
            f"{simulated[0].source.path}: measured and simulated trials have several"
            f" protocols: {', '.join(sorted(protocols))}"
        )

    rows: list[tuple[str, ...]] = []
    for planner in dict.fromkeys(entry.planner for entry in measured):
        differences_s = []
        worlds = []
        for key, results in measured_groups.items():
            if key[0] != planner or key not in simulated_groups:
                continue
            measured_s, successes = _summarize(results)
            simulated_s, simulated_successes = _summarize(simulated_groups[key])
            differences_s.append(measured_s - simulated_s)
            worlds.append(results[0].world)
            rows.append(
                (
                    spelling(planner),
                    str(results[0].world),
                    f"{measured_s:.2f}",
                    successes,
                    f"{simulated_s:.2f}",
                    simulated_successes,
                    f"{differences_s[-1]:+.2f}",
                )
            )
        if worlds:
            mean = mean_interval(np.array(differences_s), np.array(worlds))
            label = f"mean of {len(worlds)}"
            rows.append((spelling(planner), label, "", "", "", "", mean.text()))
    if not rows:
        raise ConfigError(
            f"{simulated[0].source.path}: no planner with trials in the same world as"
            f" in {measured[0].source.path}"
        )
    title = "Measured and simulated, by world"
    return TextTable("simulated", title, _COLUMNS, rows, texts=2)


def _group(entries: Iterable[Entry]) -> _Groups:
    """Return rows by (planner, world's checksum), by world; leave out unknown worlds."""
    groups: _Groups = {}
    for entry in entries:
        for row in sorted(entry.results, key=lambda row: row.world):
            if row.world_checksum:
                key = (entry.planner, row.world_checksum)
                groups.setdefault(key, []).append(row)
    return groups


def _summarize(rows: Sequence[TrialResult]) -> tuple[float, str]:
    """Return (mean counted time [s], "SUCCESSES of TRIALS") of rows."""
    times_s = [row.scores.scored_time_s for row in rows]
    successes = sum(row.scores.success for row in rows)
    return float(np.mean(times_s)), f"{successes} of {len(rows)}"
