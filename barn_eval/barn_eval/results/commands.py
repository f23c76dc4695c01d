"""Commands of trials, with which anybody can drive them again without the planner."""

import json
from collections import Counter
from collections.abc import Hashable, Iterable
from contextlib import suppress
from itertools import combinations
from operator import itemgetter

import numpy as np

from barn_eval.results.tracks import pack_arrays, parse_trial_line, unpack_arrays
from barn_eval.trials.result import REAL_TIME, TrialResult
from barn_eval.trials.spec import TrialSpec
from barn_eval.trials.trial import FinishedTrial
from barn_worlds.base.arrays import Floats
from barn_worlds.base.compute import CycleTimer
from barn_worlds.base.errors import ConfigError
from barn_worlds.base.types import nanoseconds

# A trial with more readings keeps no commands. At 20 Hz this is 37 minutes, and even
# random numbers fit into the longest line that is read.
MAX_COMMANDS = 45_000
# In m/s and rad/s. Copied commands still count as equal if changed by less.
_EQUAL = 0.01
# Two numbers of 8 bytes per reading.
_MAX_BYTES = 16 * MAX_COMMANDS


class PlannerCycles:
    """Decides when a trial asks its planner, and how late commands take effect."""

    def __init__(self, spec: TrialSpec):
        """Begin a trial with its declared or recorded delays."""
        config = spec.simulator
        self._timer = CycleTimer(spec.compute, spec.planner_seed, spec.recorded_ns)
        self._scan_ns = config.scan_steps * nanoseconds(config.control_period_s)

    def start(self, stamp_ns: int) -> int | None:
        """Start a cycle if due and return its command's delay [ns], or return None.

        A cycle starts if the instant has a scan and the planner is free. The caller then
        asks the planner.

        Args:
            stamp_ns: Time since the first reading; instants must come in order.
        """
        if stamp_ns % self._scan_ns or not self._timer.is_free(stamp_ns):
            return None
        return self._timer.start_cycle(stamp_ns)


def commands_line(finished: FinishedTrial) -> str | None:
    """Return a trial's commands as a line of commands.jsonl, or None if not repeatable.

    The line has no checksum. A trial cannot be driven again if it has no readings, too
    many, or commands over ROS that took effect at unknown times.
    """
    commands = finished.trajectory.command
    if not 0 < len(commands) <= MAX_COMMANDS or not _are_exact(finished):
        return None
    content = {"trial_id": finished.result.trial_id}
    # Exact to the last bit, because rounded commands lead to another trajectory.
    content |= pack_arrays({"commands": commands.ravel()})
    return json.dumps(content, separators=(",", ":"))


def _are_exact(finished: FinishedTrial) -> bool:
    """Tell whether each reading that starts a cycle has one command, and no other any.

    This always holds in mode direct, and never with compute in real time. Over ROS,
    commands may be late, or several to a scan.
    """
    row = finished.result
    if row.mode == "direct":
        return True
    if row.compute == REAL_TIME:
        return False
    counts = finished.trajectory.command_counts
    stamps_ns = finished.trajectory.stamps_ns
    cycles = PlannerCycles(finished.spec)
    # The last reading ends the trial, so nothing depends on whether it was answered.
    for stamp_ns, count in zip(stamps_ns[:-1] - stamps_ns[0], counts, strict=False):
        if (cycles.start(int(stamp_ns)) is not None) != count:
            return False
    return True


def parse_commands_line(line: str, where: str) -> tuple[str, Floats]:
    """Return (trial name, commands (n, 2), NaN for none); ConfigError if invalid.

    Args:
        line: The line without its checksum.
        where: File and line, for messages.

    Returns:
        The name, and the command (n, 2) of each reading in m/s and rad/s, NaN for none.

    Raises:
        ConfigError: If the line holds no commands.
    """
    trial_id, content = parse_trial_line(line, where, "commands")
    try:
        commands = unpack_arrays(content, _MAX_BYTES).get("commands", np.empty(0))
        if commands.dtype != np.float64:
            raise ValueError("commands are not 64-bit numbers")
        return trial_id, commands.reshape(-1, 2)
    except ValueError as error:
        raise ConfigError(f"{where}: no commands: {error}") from None


def count_equal_commands(
    trials: Iterable[tuple[Hashable, str, str]],
) -> Counter[tuple[str, str]]:
    """Count trials with nearly equal commands by planner pair; skip damaged lines.

    Args:
        trials: A key that compared trials share, such as the world; name of the planner;
            line of its commands. Damaged lines are ignored.
    """
    drives: dict[tuple[Hashable, int], list[tuple[str, Floats]]] = {}
    for shared, planner, line in trials:
        # Checking the trial reports a damaged line.
        with suppress(ConfigError):
            _, commands = parse_commands_line(line, planner)
            drives.setdefault((shared, len(commands)), []).append((planner, commands))
    counts: Counter[tuple[str, str]] = Counter()
    for group in drives.values():
        pairs = set()
        for (name, commands), (other, others) in combinations(
            sorted(group, key=itemgetter(0)), 2
        ):
            if name != other and np.allclose(
                commands, others, rtol=0.0, atol=_EQUAL, equal_nan=True
            ):
                pairs.add((name, other))
        counts.update(pairs)
    return counts


def requires_commands(row: TrialResult, spec: TrialSpec) -> bool:
    """Tell whether a trial must have kept commands: direct, driven and not too long.

    Args:
        row: The trial's row.
        spec: The trial.
    """
    # A trial that ended before any reading has no commands.
    readings = row.scores.duration_s / spec.simulator.control_period_s + 1.0
    is_short = readings < MAX_COMMANDS
    return row.mode == "direct" and is_short and row.measures.driven_m > 0.0
