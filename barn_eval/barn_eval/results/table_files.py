"""Read rows from a table of trials: a CSV file, or out.txt of the BARN Challenge."""

import csv
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from barn_eval.trials.result import Outcome, Scores, TrialResult, format_trial_id
from barn_eval.trials.system import NO_CONTACT, ObservedTrial, System
from barn_eval.trials.trajectory import Measures
from barn_worlds.base.errors import (
    ConfigError,
    find_duplicates,
    format_value,
    parse_number,
    suggest,
)
from barn_worlds.base.files import read_bytes

# The system of all trials in tables.
TABLE_SYSTEM = System("a table", "table", "unknown", "unknown", "unknown", NO_CONTACT)
ENDINGS = (".csv", ".txt")
COLUMNS = ("planner", "world", "repetition", "outcome", "time")
_REQUIRED = ("planner", "world", "outcome")
_LARGEST_BYTES = 1 << 26
_LARGEST_NUMBER = 10**9

# Columns of out.txt; exactly one of the three outcomes is 1.
_OUT_COLUMNS = ("world", "success", "collision", "timeout", "time", "metric")


def is_table_file(path: Path) -> bool:
    """Tell whether a path is a file, not a folder, with the ending of a table."""
    return path.suffix in ENDINGS and path.is_file()


def read_table_file(path: Path) -> list[TrialResult]:
    """Return a table's rows, NaN or None for what it lacks; ConfigError if invalid.

    Raises:
        ConfigError: If a column is missing or unknown, or a value is not allowed.
    """
    # Excel writes a byte order mark at the beginning.
    text = read_bytes(path, _LARGEST_BYTES).decode("utf-8-sig", "replace")
    lines = text.splitlines()
    trials = _csv_trials(path, lines)
    if path.suffix == ".txt":
        trials = _challenge_trials(path, lines)

    rows: dict[str, TrialResult] = {}
    counts: Counter[tuple[str, int]] = Counter()
    for where, trial in trials:
        planner = trial["planner"].strip()
        if not planner.isprintable() or not planner:
            raise ConfigError(
                f"{where}: planner {format_value(planner)}: must be a name"
            )
        world = _whole_number(where, "world", trial["world"])
        repetition = counts[planner, world]
        counts[planner, world] += 1
        if trial.get("repetition"):
            repetition = _whole_number(where, "repetition", trial["repetition"])
        trial_id = format_trial_id(planner, world, repetition)
        if trial_id in rows:
            raise ConfigError(f"{where}: trial {trial_id} is listed twice")
        rows[trial_id] = _make_row(where, path, trial, trial_id, world, repetition)
    if not rows:
        raise ConfigError(f"{path}: holds no trials")
    return list(rows.values())


def _csv_trials(path: Path, lines: list[str]) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield ("FILE, line N", texts by column) for each row; ConfigError if wrong."""
    rows = csv.reader(lines)
    columns = [name.strip().lower() for name in next(rows, [])]
    is_known = {*_REQUIRED} <= {*columns} <= {*COLUMNS}
    if not is_known or find_duplicates(columns):
        name = next((name for name in columns if name not in COLUMNS), "")
        raise ConfigError(
            f"{path}: the first line must name columns, separated by commas, each once:"
            f" {', '.join(_REQUIRED)} and perhaps {', '.join(COLUMNS)}, got"
            f" {', '.join(columns) or 'none'}{suggest(name, COLUMNS)}; of a run, name the"
            " folder instead of a file in it"
        )
    # Without blank lines.
    for values in filter(None, rows):
        where = f"{path}, line {rows.line_num}"
        if len(values) != len(columns):
            raise ConfigError(f"{where}: has {len(values)} of {len(columns)} values")
        yield where, dict(zip(columns, values, strict=True))


def _challenge_trials(
    path: Path, lines: list[str]
) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield ("FILE, line N", texts by column) for each line; ConfigError if wrong.

    The planner is named after the file.
    """
    for number, line in enumerate(lines, 1):
        where = f"{path}, line {number}"
        values = line.split()
        flags = values[1:4]
        if len(values) != len(_OUT_COLUMNS) or sorted(flags) != ["0", "0", "1"]:
            raise ConfigError(
                f"{where}: must be {' '.join(_OUT_COLUMNS)}, with a 1 for the outcome and"
                f" 0 for others, got {format_value(line)}"
            )
        trial = dict(zip(_OUT_COLUMNS, values, strict=True))
        trial["planner"] = path.stem
        trial["outcome"] = _OUT_COLUMNS[1:4][flags.index("1")]
        yield where, trial


def _make_row(
    where: str,
    path: Path,
    trial: Mapping[str, str],
    trial_id: str,
    world: int,
    repetition: int,
) -> TrialResult:
    """Return a trial's row from its values by column; ConfigError if one is wrong."""
    word = trial["outcome"].strip().lower().replace(" ", "_")
    outcomes = [outcome.value for outcome in Outcome]
    if word not in outcomes:
        raise ConfigError(
            f"{where}: unknown outcome {format_value(word)}{suggest(word, outcomes)};"
            f" must be one of {', '.join(outcomes)}"
        )
    is_success = word == Outcome.SUCCESS
    time_s = _number(where, "time", trial.get("time", ""))
    metric = _number(where, "metric", trial.get("metric", ""))
    unknown: dict[str, Any] = dict.fromkeys(item.name for item in fields(Measures))
    scored_time_s = math.nan
    if is_success:
        if time_s is None:
            raise ConfigError(f"{where}: a success needs a time")
        scored_time_s = time_s
    texts = ("world_name", "world_checksum", "preset", "mode", "detail")
    row: dict[str, Any] = dict.fromkeys(texts, "")
    row |= dict.fromkeys(("campaign_seed", "simulator_seed", "planner_seed"), 0)
    return TrialResult(
        **row,
        trial_id=trial_id,
        dataset=path.name,
        world=world,
        planner=trial["planner"].strip(),
        protocol=path.suffix.removeprefix("."),
        repetition=repetition,
        outcome=Outcome(word),
        scores=Scores(
            success=is_success,
            traversal_time_s=time_s,
            scored_time_s=scored_time_s,
            duration_s=math.nan,
            path_length_m=None,
            normalised_time_s_per_m=None,
            optimal_time_s=None,
            challenge=metric,
            challenge_2022=None,
            failure_time_s=math.nan,
        ),
        measures=Measures(**unknown | {"driven_m": math.nan, "rotation_rad": math.nan}),
        metric="success" if metric is None else "challenge",
        observed=ObservedTrial.of(TABLE_SYSTEM, "", None),
    )


def _whole_number(where: str, column: str, text: str) -> int:
    """Return a whole number from 0 to 1e9; ConfigError if the text is not one."""
    number = _number(where, column, text)
    if number is None or not number.is_integer() or number > _LARGEST_NUMBER:
        raise ConfigError(
            f"{where}: {column} {format_value(text)}: must be a whole number of 0 or more"
        )
    return int(number)


def _number(where: str, column: str, text: str) -> float | None:
    """Return a number of 0 or more, None for an empty text; ConfigError otherwise."""
    if not text.strip():
        return None
    number = parse_number(text)
    if not 0.0 <= number < math.inf:
        raise ConfigError(
            f"{where}: {column} {format_value(text)}: must be a number of 0 or more"
        )
    return number
